# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""True motion, against which estimators are scored; the entry point is ``simulate.simulate``.

simulate    computes a ``record.Truth`` from scenario, soil and mode
shear       mode "shear"; its kernels are ``motion`` (the step) and ``contact`` (the soil)
thesis      mode "thesis": the simulation of §6.2.1
"""
