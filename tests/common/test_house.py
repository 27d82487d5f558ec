# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Imports have one direction, pure code is free of ROS, records are typed, each file has its licence."""

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path
from xml.etree import ElementTree

import pytest

from trackslip_common import __version__

ROOT = Path(__file__).resolve().parents[2]
LAYERS = ("trackslip_common", "trackslip_estimation", "trackslip_bags", "trackslip_tools", "trackslip_sim")
INTERFACE = "trackslip"  # from Python
BELOW = {package: {*LAYERS[:k]} for k, package in enumerate(LAYERS)}
BELOW["trackslip_drivers"] = {"trackslip_common"}
for package in ("trackslip_bags", "trackslip_tools", "trackslip_sim"):
    BELOW[package].add("trackslip_drivers")  # device logs are decoded by the drivers
BELOW[INTERFACE] = {package for package in LAYERS if package != "trackslip_sim"}
ROS = re.compile(
    r"rclpy|launch|launch_ros|ament_index_python|rosidl_\w+|\w+_msgs|\w+_srvs|\w+_interfaces|tf2_ros"
)
# Libraries on a vehicle beside ROS: numbers, compiled code, parameters, ports and protocols, geodesy
ON_VEHICLE = {
    *("numpy", "scipy", "numba", "llvmlite", "yaml", "serial", "can", "cantools"),
    *("pynmeagps", "pyrtcm", "pyubx2", "pymap3d"),
}
RECORDS = {  # names of arguments
    *("average", "c", "config", "known", "load", "measurement", "p", "sample", "state", "thrust", "watch"),
}


@cache
def sources() -> dict[str, Path]:
    """Files of all packages by module name."""
    files = {}
    for root in ROOT.glob("src/*/"):
        for file in (root / root.name).rglob("*.py"):
            parts = file.relative_to(root).with_suffix("").parts
            files[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = file
    return files


def imports(module: str, *, deep: bool = False) -> set[str]:
    """Modules imported when a module is loaded; with ``deep`` also those imported inside functions."""
    tree, modules = ast.parse(sources()[module].read_text(encoding="utf-8")), set()
    for node in ast.walk(tree) if deep else tree.body:
        if isinstance(node, ast.Import):
            modules |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names = {f"{node.module}.{alias.name}" for alias in node.names}
            modules |= (names & sources().keys()) or {node.module}
    return modules


def libraries(names: set[str]) -> set[str]:
    """Top-level names of third-party libraries: neither ours, nor ROS, nor the standard library."""
    tops = {name.split(".")[0] for name in names} - sys.stdlib_module_names
    return {top for top in tops if not ROS.fullmatch(top) and not top.startswith("trackslip")}


def folder_of(module: str) -> str:
    """``kalman`` of ``trackslip_estimation.kalman.update``; a module outside of folders is its own folder."""
    return module.split(".")[1] if module.count(".") > 1 else module


@pytest.mark.parametrize("package", BELOW)
def test_package_imports_only_those_below_it(package: str) -> None:
    forbidden = BELOW.keys() - BELOW[package] - {package}
    wrong = {
        module: imported
        for module in sources()
        if module.split(".")[0] == package
        and (imported := {name for name in imports(module, deep=True) if name.split(".")[0] in forbidden})
    }
    assert wrong == {}


def test_modules_have_no_import_cycle() -> None:
    assert len(sources()) > 400
    list(TopologicalSorter({module: imports(module) for module in sources()}).static_order())


def test_folders_of_the_estimators_have_no_import_cycle() -> None:
    """kalman ← attitude ← slip ← soil, and the nodes above all."""
    graph: dict[str, set[str]] = {}
    for module in sources():
        if module.startswith("trackslip_estimation."):
            used = {name for name in imports(module, deep=True) if name.startswith("trackslip_estimation.")}
            graph.setdefault(folder_of(module), set()).update(map(folder_of, used))
    graph = {name: below - {name} for name, below in graph.items()}
    assert graph.keys() >= {"kalman", "attitude", "slip", "soil", "box", "gnss", "terramechanics", "nodes"}
    list(TopologicalSorter(graph).static_order())
    assert [name for name, below in graph.items() if "nodes" in below] == []


def test_only_nodes_import_ros() -> None:
    wrong = {
        module: imported
        for module in sources()
        if ".nodes" not in module
        and (imported := {name for name in imports(module, deep=True) if ROS.fullmatch(name.split(".")[0])})
    }
    assert wrong == {}


def signatures(module: str) -> Iterator[tuple[str, bool, dict[str, str]]]:
    """Name of each function, whether it is compiled, and its annotations by argument name."""
    for node in ast.walk(ast.parse(sources()[module].read_text(encoding="utf-8"))):
        if isinstance(node, ast.FunctionDef):
            decorators = {mark.id for mark in node.decorator_list if isinstance(mark, ast.Name)}
            arguments = (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)
            hints = {"return": node.returns, **{argument.arg: argument.annotation for argument in arguments}}
            annotations = {name: ast.unparse(hint) for name, hint in hints.items() if hint is not None}
            yield node.name, bool(decorators & {"compiled", "inlined"}), annotations


@pytest.mark.parametrize("folder", ["attitude", "box", "gnss", "slip", "soil", "terramechanics"])
def test_records_have_types_in_signatures(folder: str) -> None:
    """All arguments of kernels have types, and those of other functions that are passed to kernels."""
    modules = [module for module in sources() if module.startswith(f"trackslip_estimation.{folder}.")]
    assert modules
    wrong = {
        (module, function, name): hint
        for module in modules
        for function, is_compiled, hints in signatures(module)
        for name, hint in hints.items()
        if re.search(r"\bAny\b", hint) and (is_compiled or name in RECORDS)
    }
    assert wrong == {}


@pytest.mark.parametrize("package", ["trackslip_common", "trackslip_drivers", "trackslip_estimation"])
def test_package_of_the_vehicle_imports_no_library_of_the_desk(package: str) -> None:
    modules = [module for module in sources() if module.split(".")[0] == package]
    assert libraries(set().union(*(imports(module, deep=True) for module in modules))) - ON_VEHICLE == set()


def test_every_source_file_states_licence_and_copyright() -> None:
    listed = subprocess.check_output(
        ["git", "ls-files", "*.py", "*.xml", "*.js", "*.css", "*.sh"], cwd=ROOT, text=True
    )
    files = [ROOT / name for name in listed.splitlines()]
    assert len(files) > 500
    heads = {file: file.read_text(encoding="utf-8")[:400] for file in files if file.is_file()}
    for tag in ("SPDX-FileCopyrightText: 2026 Trackslip authors", "SPDX-License-Identifier: Apache-2.0"):
        assert [str(file) for file, head in heads.items() if head and tag not in head] == []


def test_all_packages_state_one_version_one_home_and_one_level() -> None:
    """A release changes them together: CONTRIBUTING.md lists the places."""
    stated = set()
    for package in sorted(ROOT.glob("src/*/package.xml")):
        about = ElementTree.parse(package).getroot()
        urls = tuple((url.get("type"), url.text) for url in about.iter("url"))
        level = re.search(
            r"\*\*level (\d)\*\*", (package.parent / "QUALITY_DECLARATION.md").read_text("utf-8")
        )
        email = about.find("maintainer").get("email")
        assert level is not None
        stated.add((about.findtext("version"), urls, email, level[1]))
        setup = package.parent / "setup.py"
        if setup.is_file():
            text = setup.read_text(encoding="utf-8")
            assert f'version="{about.findtext("version")}"' in text
            assert f'maintainer_email="{email}"' in text
    ((version, urls, email, level_of_all),) = stated
    assert version == __version__
    assert f"\nversion: {version}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert [kind for kind, _ in urls] == ["repository", "bugtracker"]
    has_home = not any("trackslip.invalid" in str(address) for address in (*urls, email))
    assert level_of_all == "4" or (
        has_home and not str(version).startswith("0.")
    )  # REP-2004: 1.ii and 2.i of level 3


def test_the_tests_of_a_module_belong_to_one_worker(request: pytest.FixtureRequest) -> None:
    """xdist reads the group from the test name; without it each worker makes the module's fixtures."""
    is_distributed = getattr(request.config.option, "loadgroup", False)  # xdist sets it in its workers
    assert request.node.nodeid.endswith("@tests/common/test_house.py") == is_distributed
