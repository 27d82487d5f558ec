# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
from pathlib import Path

from setuptools import find_packages, setup

NAME = "trackslip_common"


def config_files() -> list[str]:
    """All files below ``config/`` (a link to the checkout's), by their paths within the package."""
    package = Path(NAME)
    return [
        str(file.relative_to(package)) for file in sorted((package / "config").glob("**/*")) if file.is_file()
    ]


setup(
    name=NAME,
    version="0.1.0",
    packages=find_packages(),
    package_data={NAME: config_files()},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="Trackslip maintainers",
    maintainer_email="maintainers@trackslip.invalid",
    description="What all Trackslip packages share: configuration, parameters, errors, the base of the nodes",
    license="Apache-2.0",
)
