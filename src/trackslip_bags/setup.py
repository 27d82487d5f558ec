# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
from setuptools import find_packages, setup

NAME = "trackslip_bags"

setup(
    name=NAME,
    version="0.1.0",
    packages=find_packages(),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"], "mf4": ["asammdf>=8"]},
    zip_safe=False,
    maintainer="Trackslip maintainers",
    maintainer_email="maintainers@trackslip.invalid",
    description="Bags: recorder, reader, recovery after a power cut, import of other logs, player",
    license="Apache-2.0",
    entry_points={"console_scripts": ["record = trackslip_bags.executables:record"]},
)
