# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""True motion to score estimators against: ``simulate.simulate`` is the way in.

simulate    scenario, soil and mode to ``record.Truth``
shear       mode "shear": kernel in ``motion`` (the step) and ``contact`` (the soil)
thesis      mode "thesis": §6.2.1
kinematic   matched to sub-model 1b, for tests of estimators
"""
