# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
from pathlib import Path

from setuptools import find_packages, setup

NAME = "trackslip_common"


def config_files() -> list[tuple[str, list[str]]]:
    """All files below ``config/`` (a link to the checkout's), to be installed in the same tree."""
    folders: dict[str, list[str]] = {}
    for file in sorted(Path("config").glob("**/*")):
        if file.is_file():
            folders.setdefault(f"share/{NAME}/{file.parent}", []).append(str(file))
    return list(folders.items())


setup(
    name=NAME,
    version="0.1.0",
    packages=find_packages(),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        *config_files(),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="Trackslip maintainers",
    maintainer_email="maintainers@trackslip.invalid",
    description="What all Trackslip packages share: configuration, parameters, errors, the base of the nodes",
    license="Apache-2.0",
)
