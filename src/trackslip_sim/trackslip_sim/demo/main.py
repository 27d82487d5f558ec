# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""``python -m trackslip_sim.demo.main``: the demo, which loads only once Ctrl-C is looked after."""

from trackslip_sim.executables import demo

if __name__ == "__main__":
    demo()
