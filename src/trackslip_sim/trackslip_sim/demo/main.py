# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""``python -m trackslip_sim.demo.main``: runs the demo, loaded once Ctrl-C is handled."""

from trackslip_sim.executables import demo

if __name__ == "__main__":
    demo()
