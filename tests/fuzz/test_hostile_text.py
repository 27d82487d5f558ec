# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Hostile files of ``make fuzz`` that are made from valid ones."""

import random

import yaml

from hostile_text import _swapped


def test_swapped_values_of_yaml_include_the_root() -> None:
    texts = [_swapped(random.Random(seed), b"a: {b: 1}", b"c: 2") for seed in range(100)]
    roots = [yaml.safe_load(text) for text in texts]
    assert any(isinstance(root, dict) and "a" in root for root in roots)
    assert any(not isinstance(root, dict) for root in roots)
