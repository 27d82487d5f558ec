# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
from setuptools import find_packages, setup

NAME = "trackslip_tools"

setup(
    name=NAME,
    version="0.1.0",
    packages=find_packages(),
    package_data={f"{NAME}.{room}": ["templates/*"] for room in ("fleet", "live", "report")},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        ("bin", ["bin/trackslip"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="Trackslip maintainers",
    maintainer_email="maintainers@trackslip.invalid",
    description="Replay, smoothing, tuning, calibration and reports of bags; the command trackslip",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "trackslip = trackslip_tools.cli.main:main",
            "live = trackslip_tools.executables:live",
        ]
    },
)
