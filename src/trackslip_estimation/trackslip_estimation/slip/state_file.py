# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""The file that keeps what was learned from one start of the estimator to the next.

YAML with a checksum over all that stands before it. It is written beside itself and moved into place, by a
thread of its own: a slow, full or missing disk is counted and costs nothing else. A file that does not fit
(edited, cut, of another vehicle) is not used; the first one written in its place moves it aside, to a name of
its own. Another vehicle's is named after that vehicle, which finds it there when its turn comes.
"""

import hashlib
import threading
import time
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import yaml

from trackslip_common.errors import InputError
from trackslip_common.kept_files import move_aside, own_file
from trackslip_common.whole_file import replacing
from trackslip_common.yaml_text import parse_yaml
from trackslip_estimation.slip.learned import Learned, Meaning, OtherMachine, aged, from_tree, to_tree
from trackslip_estimation.slip.learned_text import findings, lines_of

_VERSION = 2
_LARGEST = 1 << 18  # bytes
_UNKNOWN_AGE = 7 * 86400.0  # s, where the clock cannot be right: the ground is forgotten, the machine not
_EARLIEST, _OLDEST = -60.0, 10 * 365 * 86400.0  # s, ages that are believed: some clocks begin in 1970
_END = 3.0  # s that the last writing may take
CHECKSUM = "\nchecksum: "
_HEAD = """\
# What the slip estimator has learned of this machine and its ground; it starts from this the next time.
# Not to be edited: then it is not used. To forget it, call ~/forget, or delete this file.
# ± is one standard deviation.
"""


def state_text(learned: Learned, of: Meaning, written_s: float) -> str:
    """What the file holds; ``written_s``: seconds since 1970."""
    words = [f"#   {line}\n" for line in lines_of(findings(learned, of))]
    written = datetime.fromtimestamp(written_s, timezone.utc).isoformat()
    tree = {"version": _VERSION, "written": written, **to_tree(learned, of)}
    body = _HEAD + "".join(words) + yaml.safe_dump(tree, sort_keys=False, default_flow_style=None, width=95)
    body = body.rstrip("\n")
    return f"{body}{CHECKSUM}{digest(body)}\n"


def parse_state(text: str, of: Meaning) -> tuple[Learned, float]:
    """What was learned, and when it was written, seconds since 1970.

    Raises:
        InputError: the text is not as ``state_text`` made it, or of another machine.
    """
    body, sign, checksum = text.rpartition(CHECKSUM)
    if not sign or checksum.strip() != digest(body):
        raise InputError("it was edited, or cut off")
    tree: Any = parse_yaml(body, "state file")
    if not isinstance(tree, dict) or tree.get("version") != _VERSION:
        raise InputError("it is of another version")
    try:
        written_s = datetime.fromisoformat(str(tree.get("written"))).timestamp()
    except (ValueError, OverflowError) as error:
        raise InputError("it does not say when it was written") from error
    return from_tree(tree, of), written_s


class StateFile:
    """One node's; with an empty path there is none, and nothing is ever done."""

    def __init__(self, path: str) -> None:
        """``path`` may begin with ~.

        Raises:
            InputError: nobody knows that home directory.
        """
        self._path = own_file("state_file", path)
        self._is_foreign = False  # what is there was not used
        self._other = ""  # the machine that it is of, where that is known
        self._damaged: Path | None = None  # what was kept aside of this machine, and was not used
        self._writer: threading.Thread | None = None
        self._lock = threading.Lock()
        self._written_s: float | None = None
        self.used = True  # whether what was there could be used, or nothing was
        self.note = ""  # what became of reading it
        self.failures = 0
        self.failure = ""  # why the last writing failed; empty where it did not

    def __bool__(self) -> bool:
        return self._path is not None

    def read(self, of: Meaning) -> Learned | None:
        """What is there, widened with its age; None where nothing is of use: see ``note``."""
        if self._path is None:
            return None
        self._is_foreign, self._other, self._damaged, self.used = False, "", None, True
        try:
            if self._path.exists():
                return self._used(self._path, of)
            self.note = f"nothing learned before: no file {self._path}"
        except (InputError, OSError) as error:
            self._is_foreign = True
            self._other = error.machine if isinstance(error, OtherMachine) else ""
            self.note = _refusal(self._path, error)
        aside = _aside(self._path, of.machine)
        if (self._other or not self._is_foreign) and aside.exists():
            try:
                return self._used(aside, of)
            except (InputError, OSError) as error:
                self._damaged = aside
                self.note += f"; {_refusal(aside, error)}"
        self.used = not self._is_foreign and self._damaged is None
        return None

    def _used(self, path: Path, of: Meaning) -> Learned:
        """What a file holds.

        Raises:
            InputError: it does not fit.
            OSError: it cannot be read.
        """
        learned, written_s = parse_state(_content(path), of)
        age_s = time.time() - written_s
        known = _EARLIEST < age_s < _OLDEST
        age = _words(max(age_s, 0.0)) if known else "at an unknown time"
        self.note = f"starts from what was learned {age} ({path})"
        return aged(learned, max(age_s, 0.0) if known else _UNKNOWN_AGE, of)

    def write(self, learned: Learned | None, of: Meaning) -> None:
        """Begin to write; nothing where the last one still goes on."""
        if self._path is None or learned is None:
            return
        if self._writer is not None and self._writer.is_alive():
            self._fail("the disk is too slow")
            return
        arguments = (self._path, learned, of)
        self._writer = threading.Thread(target=self._write, args=arguments, name="state_file", daemon=True)
        self._writer.start()

    def forget(self, of: Meaning) -> None:
        """Delete what is kept of this machine; a file that was not used is moved aside."""
        self.finish()
        try:
            if self._path is not None:
                self._move_aside(self._path)
                self._path.unlink(missing_ok=True)
                _aside(self._path, of.machine).unlink(missing_ok=True)
        except OSError as error:
            self._fail(f"not deleted: {error.strerror}")

    def finish(self) -> None:
        """Wait for what is being written."""
        if self._writer is not None:
            self._writer.join(_END)
            if self._writer.is_alive():
                self._fail("the disk is too slow")

    def status(self) -> dict[str, str]:
        """For /diagnostics."""
        with self._lock:
            ago = "not yet" if self._written_s is None else _words(time.time() - self._written_s)
            values = {"file": str(self._path), "read": self.note, "written": ago}
            return values | {"not written": str(self.failures), "last failure": self.failure or "none"}

    def _write(self, path: Path, learned: Learned, of: Meaning) -> None:
        """In its own thread."""
        now_s = time.time()
        try:
            text = state_text(learned, of, now_s)
            path.parent.mkdir(parents=True, exist_ok=True)
            with replacing(path, text, sync=True):  # the key may be turned at any time
                self._move_aside(path)
        except (OSError, ValueError) as error:  # ValueError: no path at all
            self._fail(getattr(error, "strerror", None) or str(error))
            return
        with self._lock:
            self._written_s, self.failure = now_s, ""

    def _move_aside(self, path: Path) -> None:
        """Where it is a file that was not used; and what of this machine was not."""
        if self._damaged is not None:
            move_aside(self._damaged)
            self._damaged = None
        if self._is_foreign and self._other and path.exists():
            path.replace(_aside(path, self._other))  # over what that one knew before
        elif self._is_foreign:
            move_aside(path)
        self._is_foreign = False

    def _fail(self, reason: str) -> None:
        with self._lock:
            self.failures += 1
            self.failure = reason


def _aside(path: Path, machine: str) -> Path:
    """Where the file of a machine is kept while another one's is in its place."""
    return path.with_name(f"{path.name}.of-{digest(machine)[:8]}")


def _refusal(path: Path, error: Exception) -> str:
    return f"{path} is not used: {error.strerror if isinstance(error, OSError) else error}"


def _content(path: Path) -> str:
    """Of a file of moderate size.

    Raises:
        InputError: it is none.
        OSError: it cannot be read.
    """
    if not path.is_file():
        raise InputError("it is no file")
    with path.open("rb") as file:
        content = file.read(_LARGEST + 1)
    if len(content) > _LARGEST:
        raise InputError(f"it is larger than {_LARGEST >> 10} KiB")
    return content.decode("utf-8", errors="replace")


def digest(body: str) -> str:
    """Checksum of a text, in hexadecimal digits."""
    return hashlib.sha256(body.encode(errors="replace")).hexdigest()[:32]


def _words(age_s: float) -> str:
    """How long ago."""
    for unit, seconds in (("days", 2 * 86400.0), ("h", 2 * 3600.0), ("min", 2 * 60.0)):
        if age_s >= seconds:
            return f"{age_s / (seconds / 2.0):.0f} {unit} ago"
    return f"{age_s:.0f} s ago"
