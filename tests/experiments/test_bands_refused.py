"""Commands that know one gain alone refuse bands of speed in one line, before they do anything."""

import pytest

from jaxtube.experiments.cli import main


@pytest.mark.parametrize("words", [["tune"], ["maps"], ["fit", "slip"]])
def test_bands_are_refused_before_a_wait_is_told(words, tmp_path, capsys):
    folder = tmp_path / "run"
    assert main([*words, "--scenario", "certified_wide", "--out", str(folder)]) == 2
    told = capsys.readouterr()
    (line,) = told.err.splitlines()
    assert line.startswith("certified_wide: operating.bands: ")
    assert not told.out and not folder.exists()
