# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
from setuptools import find_packages, setup

NAME = "trackslip"

setup(
    name=NAME,
    version="0.1.0",
    packages=find_packages(),
    package_data={NAME: ["py.typed", "example/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="Trackslip maintainers",
    maintainer_email="maintainers@trackslip.invalid",
    description="The Python interface: estimates of a log, a bag or a data frame as arrays",
    license="Apache-2.0",
)
