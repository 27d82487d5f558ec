# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Imports have one direction and are declared; records are typed; each file has its licence."""

import ast
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterable, Iterator
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import pytest
import yaml

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
DESK = {"rosbags", "polars", "bokeh", "matplotlib", "distributed", "dask", "rich", "jinja2", "ruamel"}
FROM_PIP = {"bokeh", "cantools", "distributed", "mcap", "polars", "pynmeagps", "pyrtcm", "pyubx2", "rosbags"}
FROM_APT = {  # python3-NAME
    *(
        "can",
        "jinja2",
        "lz4",
        "matplotlib",
        "numba",
        "numpy",
        "pymap3d",
        "rich",
        "scipy",
        "serial",
        "tornado",
    ),
    *("yaml", "zstandard"),
}
ROSDEP_KEYS = {
    **{name: f"python3-{name}-pip" for name in FROM_PIP},
    **{name: f"python3-{name}" for name in FROM_APT},
    "llvmlite": "python3-numba",  # build dependency
}
OF_LIBRARIES = {"python3-msgpack"}  # imported by python-can's udp_multicast
SYSTEMS = {"debian", "ubuntu"}
RECORDS = {  # names of arguments
    *("average", "c", "config", "known", "load", "measurement", "p", "sample", "state", "thrust", "watch"),
}
MOVES = {
    "trackslip_common/atomic_files.py",  # into place
    "trackslip_common/kept_files.py",  # aside
    "trackslip_estimation/slip/state_file.py",  # aside, to the machine's name
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


class Facts(NamedTuple):
    """What one reading of a source file shows."""

    imports: set[str]  # modules imported when the file is loaded
    all_imports: set[str]  # and those imported inside functions
    moves_files: bool


@cache
def facts(file: Path) -> Facts:
    tree = ast.parse(file.read_text(encoding="utf-8"))
    nodes = list(ast.walk(tree))
    return Facts(imported(tree.body), imported(nodes), any(map(moves_file, nodes)))


def moves_file(node: ast.AST) -> bool:
    """Whether this call moves a file: ``Path.replace`` has one argument, ``str.replace`` has two."""
    if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute)):
        return False
    if node.func.attr in ("replace", "rename"):
        of_system = isinstance(node.func.value, ast.Name) and node.func.value.id == "os"
        return of_system or (len(node.args) == 1 and not node.keywords)
    return ast.unparse(node.func) == "shutil.move"


def imported(nodes: Iterable[ast.AST]) -> set[str]:
    """Modules that the statements among ``nodes`` import."""
    modules = set()
    for node in nodes:
        if isinstance(node, ast.Import):
            modules |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names = {f"{node.module}.{alias.name}" for alias in node.names}
            modules |= (names & sources().keys()) or {node.module}
    return modules


def all_imports(package: str) -> dict[str, set[str]]:
    """Modules imported anywhere in the modules of a package, by module."""
    return {m: facts(file).all_imports for m, file in sources().items() if top(m) == package}


def top(module: str) -> str:
    return module.split(".")[0]


def folder_of(module: str) -> str:
    """``kalman`` of ``trackslip_estimation.kalman.update``; a module outside of folders is its own folder."""
    return module.split(".")[1] if module.count(".") > 1 else module


@pytest.mark.parametrize("package", BELOW)
def test_package_imports_only_those_below_it(package: str) -> None:
    forbidden = BELOW.keys() - BELOW[package] - {package}
    wrong = {
        module: found
        for module, names in all_imports(package).items()
        if (found := {name for name in names if top(name) in forbidden})
    }
    assert wrong == {}


def test_modules_have_no_import_cycle() -> None:
    assert len(sources()) > 400
    list(
        TopologicalSorter({module: facts(file).imports for module, file in sources().items()}).static_order()
    )


def test_folders_of_the_estimators_have_no_import_cycle() -> None:
    """kalman ← attitude ← slip ← soil, and the nodes above all."""
    graph: dict[str, set[str]] = {}
    for module, names in all_imports("trackslip_estimation").items():
        used = {name for name in names if name.startswith("trackslip_estimation.")}
        graph.setdefault(folder_of(module), set()).update(map(folder_of, used))
    graph = {name: below - {name} for name, below in graph.items()}
    assert graph.keys() >= {"kalman", "attitude", "slip", "soil", "box", "gnss", "terramechanics", "nodes"}
    list(TopologicalSorter(graph).static_order())
    assert [name for name, below in graph.items() if "nodes" in below] == []


def test_only_nodes_import_ros() -> None:
    wrong = {
        module: found
        for module, file in sources().items()
        if ".nodes" not in module
        and (found := {name for name in facts(file).all_imports if ROS.fullmatch(top(name))})
    }
    assert wrong == {}


@pytest.mark.parametrize("package", ["trackslip_common", "trackslip_drivers", "trackslip_estimation"])
def test_package_of_the_vehicle_imports_no_library_of_the_desk(package: str) -> None:
    tops = {top(name) for names in all_imports(package).values() for name in names} - sys.stdlib_module_names
    libraries = {name for name in tops if not ROS.fullmatch(name) and not name.startswith("trackslip")}
    assert libraries - ON_VEHICLE == set()


def test_recorder_loads_no_library_of_the_desk() -> None:
    """Definitions of topics load none either: a recorder needs them beyond its imports."""
    code = """
import sys, trackslip_bags.nodes.record
from trackslip_bags.writer import own_schema
from trackslip_common.topics import TOPICS
for name, topic in TOPICS.items():
    if name != "tf":  # its package is optional
        own_schema(topic.type_name)
print(*{name.partition('.')[0] for name in sys.modules})
"""
    script = Path(sys.prefix) / "trackslip.sh"
    has_ros = os.environ.get("AMENT_PREFIX_PATH") or not script.is_file()
    sourced = [] if has_ros else ["sh", "-c", f'. "{script}"; exec "$0" "$@"']
    command = [*sourced, sys.executable, "-c", code]
    loaded = set(subprocess.run(command, capture_output=True, text=True, check=True).stdout.split())
    assert loaded >= {"rclpy", "mcap"}
    assert loaded & DESK == set()


def declared(package: str) -> set[str]:
    """Keys of the runtime dependencies of a package."""
    description = ElementTree.parse(ROOT / "src" / package / "package.xml").getroot()
    return {str(element.text) for tag in ("depend", "exec_depend") for element in description.iter(tag)}


@pytest.mark.parametrize("package", BELOW)
def test_package_declares_the_libraries_that_it_imports_and_no_others(package: str) -> None:
    files = [file for module, file in sources().items() if top(module) == package]
    files += (ROOT / "src" / package / "launch").rglob("*.py")
    used = (
        {top(name) for file in files for name in facts(file).all_imports}
        - sys.stdlib_module_names
        - {package}
    )
    keys = {ROSDEP_KEYS.get(name, name) for name in used}
    assert keys - declared(package) == set()
    assert {key for key in declared(package) if key.startswith("python3-")} - keys - OF_LIBRARIES == set()


def test_keys_that_install_by_pip_are_defined_for_each_system_that_the_packages_run_on() -> None:
    """A rosdep database may lack them: ours is shipped, and has no unused key."""
    defined = yaml.safe_load((ROOT / "deploy" / "rosdep.yaml").read_text(encoding="utf-8"))
    assert {key for key, rules in defined.items() if rules.keys() != SYSTEMS} == set()
    needed = set.union(*map(declared, BELOW))
    assert defined.keys() - needed == set()
    assert {key for key in needed if key.endswith("-pip")} - defined.keys() == {"python3-bokeh-pip"}


@pytest.mark.parametrize("file", ["docs/install.md", "deploy/Dockerfile", ".github/workflows/ci.yml"])
def test_rosdep_instructions_name_our_keys_and_the_remaining_pip_packages(file: str) -> None:
    """numba remains: its version in Debian 12 is too old for the kernels."""
    requirements = (ROOT / "requirements" / "with-apt-ros.txt").read_text(encoding="utf-8").splitlines()
    text = (ROOT / file).read_text(encoding="utf-8")
    assert "deploy/rosdep.yaml" in text
    line = text.split("pip install ", 1)[1].splitlines()[0]
    assert shlex.split(line.split("#")[0].rstrip(" \\")) == [r for r in requirements if r.startswith("numba")]


def signatures(file: Path) -> Iterator[tuple[str, bool, dict[str, str]]]:
    """Name of each function, whether it is compiled, and its annotations by argument name."""
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.FunctionDef):
            decorators = {mark.id for mark in node.decorator_list if isinstance(mark, ast.Name)}
            arguments = (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)
            hints = {"return": node.returns, **{argument.arg: argument.annotation for argument in arguments}}
            annotations = {name: ast.unparse(hint) for name, hint in hints.items() if hint is not None}
            yield node.name, bool(decorators & {"compiled", "inlined"}), annotations


@pytest.mark.parametrize("folder", ["attitude", "box", "gnss", "slip", "soil", "terramechanics"])
def test_records_have_types_in_signatures(folder: str) -> None:
    """All arguments of kernels have types, and those of other functions that are passed to kernels."""
    files = {m: file for m, file in sources().items() if m.startswith(f"trackslip_estimation.{folder}.")}
    assert files
    wrong = {
        (module, function, name): hint
        for module, file in files.items()
        for function, is_compiled, hints in signatures(file)
        for name, hint in hints.items()
        if re.search(r"\bAny\b", hint) and (is_compiled or name in RECORDS)
    }
    assert wrong == {}


def test_files_are_moved_into_place_by_one_module() -> None:
    moving = {file for file in sources().values() if facts(file).moves_files}
    assert {file.relative_to(ROOT / "src").as_posix().partition("/")[2] for file in moving} == MOVES


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
