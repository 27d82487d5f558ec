# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
"""Links of the API pages: what leads nowhere is found."""

from pathlib import Path

from make_docs import broken_links


def test_links_that_lead_nowhere_are_found(tmp_path: Path) -> None:
    (tmp_path / "room").mkdir()
    (tmp_path / "index.html").write_text(
        '<a href="room/page.html#there">1</a> <a href="room/page.html#gone">2</a> <a href="none.html">3</a>'
        ' <a href="https://example.org/x">4</a> <a href="#here">5</a> <p id="here">',
        encoding="utf-8",
    )
    (tmp_path / "room" / "page.html").write_text(
        '<p id="there"><a href="../index.html">6</a>', encoding="utf-8"
    )
    assert broken_links(tmp_path) == ["index.html: none.html", "index.html: room/page.html#gone"]
