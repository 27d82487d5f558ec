# SPDX-License-Identifier: Apache-2.0
"""Start-up hook of ``.venv``: every python started from it finds ROS 2 and the workspace, nothing sourced.

``scripts/setup_workspace.py`` installs this file into the virtual environment, with a ``.pth`` line that
calls :func:`enter` at each start and a JSON file of the variables. The dynamic linker reads LD_LIBRARY_PATH
only when a process begins, so the hook sets the environment and executes the same command once more: same
process id, same arguments, same open files. Child processes inherit the environment and start straight away.
"""

import os
import sys

GUARD = "_TRACKSLIP_ENVIRONMENT"


def enter(stamp: str) -> None:
    """Executes this command again within the environment marked ``stamp``, unless it runs there already."""
    if os.environ.get(GUARD) == stamp or not sys.executable:
        return
    import json  # here, where they are needed: this module is read at every start
    from pathlib import Path

    settings = json.loads(Path(__file__).with_suffix(".json").read_text(encoding="utf-8"))
    environment = {**settings["defaults"], **os.environ, **settings["values"], GUARD: stamp}
    for name, paths in settings["paths"].items():
        present = [path for path in os.environ.get(name, "").split(os.pathsep) if path and path not in paths]
        environment[name] = os.pathsep.join(paths + present)
    os.execve(sys.executable, [sys.executable, *sys.orig_argv[1:]], environment)
