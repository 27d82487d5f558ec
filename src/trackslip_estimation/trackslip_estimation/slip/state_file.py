# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""State file: stores learned values between two starts of the estimator.

The file is YAML, with a checksum over the text before it. A separate thread writes a temporary file and
renames it: a slow, full or missing disk is counted and has no other effect. An invalid file (edited, cut, of
another vehicle) is not used; the first write then renames it. The file of another vehicle gets a name with
the digest of that vehicle, under which that vehicle finds it later.
"""

import hashlib
import threading
import time
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import yaml

from trackslip_common.atomic_files import atomic_replacement
from trackslip_common.errors import InputError
from trackslip_common.kept_files import move_aside, parameter_path
from trackslip_common.yaml_text import parse_yaml
from trackslip_estimation.slip.learned import (
    Learned,
    LearnedContext,
    OtherMachineError,
    decay_to_prior,
    from_tree,
    to_tree,
)
from trackslip_estimation.slip.learned_text import learned_quantities, quantity_lines

_VERSION = 2
_LARGEST_SIZE = 1 << 18  # bytes
_UNKNOWN_AGE = 7 * 86400.0  # s, with a wrong clock: discards states of the ground, keeps those of the machine
_EARLIEST, _OLDEST = -60.0, 10 * 365 * 86400.0  # bounds of a plausible age, s: some clocks start in 1970
_WRITE_TIMEOUT = 3.0  # longest wait for the last write, s
CHECKSUM = "\nchecksum: "
_HEADER = """\
# What the slip estimator has learned of this machine and its ground; it starts from this the next time.
# Not to be edited: then it is not used. To forget it, call ~/forget, or delete this file.
# ± is one standard deviation.
"""


def state_text(learned: Learned, context: LearnedContext, written_s: float) -> str:
    """Text of the state file; ``written_s``: seconds since 1970."""
    comments = [f"#   {line}\n" for line in quantity_lines(learned_quantities(learned, context))]
    written = datetime.fromtimestamp(written_s, timezone.utc).isoformat()
    tree = {"version": _VERSION, "written": written, **to_tree(learned, context)}
    body = (
        _HEADER + "".join(comments) + yaml.safe_dump(tree, sort_keys=False, default_flow_style=None, width=95)
    )
    body = body.rstrip("\n")
    return f"{body}{CHECKSUM}{digest(body)}\n"


def parse_state(text: str, context: LearnedContext) -> tuple[Learned, float]:
    """Parse the text of a state file: learned values, and the time of writing, seconds since 1970.

    Raises:
        InputError: the text is not an unchanged output of ``state_text``, or is of another machine.
    """
    body, separator, checksum = text.rpartition(CHECKSUM)
    if not separator or checksum.strip() != digest(body):
        raise InputError("its checksum is wrong: it was edited or truncated")
    tree: Any = parse_yaml(body, "state file")
    if not isinstance(tree, dict) or tree.get("version") != _VERSION:
        raise InputError("it is of another version")
    try:
        written_s = datetime.fromisoformat(str(tree.get("written"))).timestamp()
    except (ValueError, OverflowError) as error:
        raise InputError("its time of writing is missing") from error
    return from_tree(tree, context), written_s


class StateFile:
    """State file of one node; with an empty path nothing is read or written."""

    def __init__(self, path: str) -> None:
        """``path`` may begin with ~.

        Raises:
            InputError: the home directory is unknown.
        """
        self._path = parameter_path("state_file", path)
        self._is_unused = False  # whether the existing file was not used
        self._other_machine = ""  # machine of that file, if known
        self._damaged: Path | None = None  # file of this machine under its digest, if invalid
        self._writer: threading.Thread | None = None
        self._lock = threading.Lock()
        self._written_s: float | None = None
        self.used = True  # False: a file exists but was not used
        self.note = ""  # result of reading the file
        self.failures = 0
        self.failure = ""  # reason why the last write failed; empty if it succeeded

    def __bool__(self) -> bool:
        return self._path is not None

    def read(self, context: LearnedContext) -> Learned | None:
        """Read the learned values, decayed to now; None if no file is usable, see ``note``."""
        if self._path is None:
            return None
        self._is_unused, self._other_machine, self._damaged, self.used = False, "", None, True
        try:
            if self._path.exists():
                return self._read_decayed(self._path, context)
            self.note = f"no learned values: there is no file {self._path}"
        except (InputError, OSError) as error:
            self._is_unused = True
            self._other_machine = error.machine if isinstance(error, OtherMachineError) else ""
            self.note = _rejection_text(self._path, error)
        aside = _path_for_machine(self._path, context.machine)
        if (self._other_machine or not self._is_unused) and aside.exists():
            try:
                return self._read_decayed(aside, context)
            except (InputError, OSError) as error:
                self._damaged = aside
                self.note += f"; {_rejection_text(aside, error)}"
        self.used = not self._is_unused and self._damaged is None
        return None

    def _read_decayed(self, path: Path, context: LearnedContext) -> Learned:
        """Read a file and decay its values to now; set ``note``.

        Raises:
            InputError: the file is invalid or of another machine.
            OSError: the file cannot be read.
        """
        learned, written_s = parse_state(_read_text(path), context)
        age_s = time.time() - written_s
        is_plausible = _EARLIEST < age_s < _OLDEST
        age = _age_text(max(age_s, 0.0)) if is_plausible else "at an unknown time"
        self.note = f"starts from values learned {age} ({path})"
        return decay_to_prior(learned, max(age_s, 0.0) if is_plausible else _UNKNOWN_AGE, context)

    def write(self, learned: Learned | None, context: LearnedContext) -> None:
        """Start writing; count a failure if the previous write is still running."""
        if self._path is None or learned is None:
            return
        if self._writer is not None and self._writer.is_alive():
            self._count_failure("the disk is too slow")
            return
        arguments = (self._path, learned, context)
        self._writer = threading.Thread(target=self._write, args=arguments, name="state_file", daemon=True)
        self._writer.start()

    def forget(self, context: LearnedContext) -> None:
        """Delete the files of this machine; a file that was not used is renamed instead."""
        self.finish()
        try:
            if self._path is not None:
                self._move_aside(self._path)
                self._path.unlink(missing_ok=True)
                _path_for_machine(self._path, context.machine).unlink(missing_ok=True)
        except OSError as error:
            self._count_failure(f"not deleted: {error.strerror}")

    def finish(self) -> None:
        """Wait for a running write."""
        if self._writer is not None:
            self._writer.join(_WRITE_TIMEOUT)
            if self._writer.is_alive():
                self._count_failure("the disk is too slow")

    def status(self) -> dict[str, str]:
        """Values for /diagnostics."""
        with self._lock:
            ago = "not yet" if self._written_s is None else _age_text(time.time() - self._written_s)
            values = {"file": str(self._path), "read": self.note, "written": ago}
            return values | {"not written": str(self.failures), "last failure": self.failure or "none"}

    def _write(self, path: Path, learned: Learned, context: LearnedContext) -> None:
        """Write the file; runs in the writer thread."""
        now_s = time.time()
        try:
            text = state_text(learned, context, now_s)
            path.parent.mkdir(parents=True, exist_ok=True)
            with atomic_replacement(path, text, sync=True):  # power may be switched off at any time
                self._move_aside(path)
        except (OSError, ValueError) as error:  # ValueError: invalid path
            self._count_failure(getattr(error, "strerror", None) or str(error))
            return
        with self._lock:
            self._written_s, self.failure = now_s, ""

    def _move_aside(self, path: Path) -> None:
        """Rename a file that was not used, and an invalid file of this machine."""
        if self._damaged is not None:
            move_aside(self._damaged)
            self._damaged = None
        if self._is_unused and self._other_machine and path.exists():
            path.replace(
                _path_for_machine(path, self._other_machine)
            )  # replaces an older file of that machine
        elif self._is_unused:
            move_aside(path)
        self._is_unused = False

    def _count_failure(self, reason: str) -> None:
        with self._lock:
            self.failures += 1
            self.failure = reason


def _path_for_machine(path: Path, machine: str) -> Path:
    """Path of a machine's file while the state file belongs to another machine."""
    return path.with_name(f"{path.name}.of-{digest(machine)[:8]}")


def _rejection_text(path: Path, error: Exception) -> str:
    return f"{path} is not used: {error.strerror if isinstance(error, OSError) else error}"


def _read_text(path: Path) -> str:
    """Text of a file.

    Raises:
        InputError: the path is no file, or the file is too large.
        OSError: the file cannot be read.
    """
    if not path.is_file():
        raise InputError("it is not a regular file")
    with path.open("rb") as file:
        content = file.read(_LARGEST_SIZE + 1)
    if len(content) > _LARGEST_SIZE:
        raise InputError(f"it is larger than {_LARGEST_SIZE >> 10} KiB")
    return content.decode("utf-8", errors="replace")


def digest(body: str) -> str:
    """Checksum of a text, in hexadecimal digits."""
    return hashlib.sha256(body.encode(errors="replace")).hexdigest()[:32]


def _age_text(age_s: float) -> str:
    """Age as text, "2 h ago"."""
    for unit, seconds in (("days", 2 * 86400.0), ("h", 2 * 3600.0), ("min", 2 * 60.0)):
        if age_s >= seconds:
            return f"{age_s / (seconds / 2.0):.0f} {unit} ago"
    return f"{age_s:.0f} s ago"
