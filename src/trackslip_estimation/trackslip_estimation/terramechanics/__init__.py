# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Chapters 2 and 3 of the thesis, one equation per function: soil, tracks, turning, hydraulics.

Every function takes scalars or arrays, which broadcast, in SI units and radians; scalars come back as
numpy scalars. An impossible argument raises ``InputError`` naming it, its value and the accepted range.

    strength    Mohr-Coulomb and the thrust the ground can bear   (2.1)-(2.4), (3.1)
    sinkage     pressure and sinkage                              (2.5)-(2.8)
    resistance  motion resistance of a track                      §2.5.4, (3.10)
    traction    thrust and slip                                   (3.2), (3.3), (3.12)
    turning     lateral forces, moment, centre of rotation        (3.4)-(3.9), (3.13)
    hydraulics  pressure, torque and thrust; flow and speed       (3.25), (3.27), appendix B
"""
