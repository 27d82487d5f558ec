# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
from glob import glob

from setuptools import find_packages, setup

NAME = "trackslip_drivers"

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
    description="Drivers of the excavator's sensors: CAN, Watson IMU, SICK PLS, NMEA GNSS receivers",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "can_driver = trackslip_drivers.executables:can_driver",
            "watson_imu = trackslip_drivers.executables:watson_imu",
            "sick_pls = trackslip_drivers.executables:sick_pls",
            "nmea_gnss = trackslip_drivers.executables:nmea_gnss",
            "wheel_adapter = trackslip_drivers.executables:wheel_adapter",
        ]
    },
)
