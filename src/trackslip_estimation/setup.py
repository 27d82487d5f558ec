# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
from glob import glob

from setuptools import find_packages, setup

NAME = "trackslip_estimation"

setup(
    name=NAME,
    version="0.1.0",
    packages=find_packages(),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", sorted(glob("launch/*.launch.py"))),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="Trackslip maintainers",
    maintainer_email="maintainers@trackslip.invalid",
    description="Pose, track slip and soil of a tracked vehicle, estimated while it drives",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "box_localizer = trackslip_estimation.executables:box_localizer",
            "gnss_localizer = trackslip_estimation.executables:gnss_localizer",
            "slip_estimator = trackslip_estimation.executables:slip_estimator",
            "soil_estimator = trackslip_estimation.executables:soil_estimator",
            "record = trackslip_estimation.executables:record",
        ]
    },
)
