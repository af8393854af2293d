"""The folder of a run: what was asked, what came out, and what produced it.

    metrics.json     plain numbers, units in the key; there once the run is complete
    scenario.toml    the scenario with every key spelled out
    manifest.json    versions, platform, hashes of scenario and sources, command line, seed, date,
                     git commit
    report.txt       what was printed
    report.html      the same and more as one page: figures, laps to play, certificate, environment
    NAME.png, NAME.pdf, NAME.npz

Files appear complete or not at all. Those of an earlier run are replaced, each by the new one, and
not before: a run that fails leaves them as they are.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import importlib.util
import json
import math
import os
import platform
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import msgspec
import numpy as np

from jaxtube.atomic import write_atomically
from jaxtube.experiments.options import Options, command_line
from jaxtube.experiments.run.captions import find_caption
from jaxtube.experiments.run.json_file import read_table
from jaxtube.scenario.refusal import ScenarioError, refusal
from jaxtube.scenario.tree import Scenario, to_toml

if TYPE_CHECKING:
    from jaxtube.reporting.page import Page

PACKAGES = (
    "jaxtube",
    "jax",
    "jaxlib",
    "numpy",
    "scipy",
    "clarabel",
    "highspy",
    "msgspec",
    "matplotlib",
)
COMPUTING_PACKAGES = ("jax", "jaxlib", "numpy", "scipy", "clarabel", "highspy")
"""Those whose version may change the numbers of a run."""
SCENARIOS = ("scenario.toml", "against.toml", "tuned.toml", "identified.toml", "fitted.toml")
"""Scenarios that commands write."""


@dataclass(frozen=True)
class RunFolder:
    """The folder of one run; its methods write files into it.

    Attributes:
        path: the folder.
        scenario: text of scenario.toml, written with the metrics.
        manifest: content of manifest.json, written with the metrics.
    """

    path: Path
    scenario: str = ""
    manifest: Mapping[str, Any] = field(default_factory=dict)
    _printed: list[str] = field(default_factory=list)
    _drawn: dict[str, str] = field(default_factory=dict)  # figures in words, by name

    def report(self, text: str, name: str = "report") -> None:
        """Print a part of the report, and save all parts so far as NAME.txt."""
        print(text)
        self._printed.append(f"{text}\n")
        self._write_text(f"{name}.txt", "".join(self._printed))

    def save_metrics(self, metrics: Mapping[str, Any]) -> None:
        """Write scenario.toml and manifest.json, then metrics.json with sorted keys; numbers that
        are not finite become null.

        Raises:
            TypeError: for what is no number, text, list or mapping.
        """
        plain = _make_plain(metrics)
        if self.manifest:
            self._write_text("scenario.toml", self.scenario)
            self._write_json("manifest.json", self.manifest)
        self._write_json("metrics.json", plain)

    def save_figure(self, figure: Any, name: str) -> None:
        """Write a matplotlib figure as NAME.png and NAME.pdf; equal figures give equal bytes."""
        from jaxtube.reporting.alternatives import describe_figure

        undated = {"CreationDate": None}
        self._write(f"{name}.png", lambda file: figure.savefig(file, format="png", dpi=200))
        self._write(
            f"{name}.pdf", lambda file: figure.savefig(file, format="pdf", metadata=undated)
        )
        self._drawn[name] = describe_figure(figure)

    def save_page(self, page: Page) -> None:
        """Write report.html: what a command found, with the text and the figures so far; the last
        thing that a command writes."""
        from jaxtube.reporting.document import render
        from jaxtube.reporting.page import Picture, Run

        pictures = [
            Picture(name, find_caption(name), words, (self.path / f"{name}.png").read_bytes())
            for name, words in self._drawn.items()
        ]
        title = self.manifest.get("title", self.path.name)
        run = Run(title, "".join(self._printed), self.manifest, pictures)
        self._write_text("report.html", render(page, run))

    def save_json(self, name: str, content: Mapping[str, Any]) -> None:
        """Write NAME.json like metrics.json."""
        self._write_json(f"{name}.json", _make_plain(content))

    def save_arrays(self, name: str, **arrays: Any) -> None:
        """Write arrays as NAME.npz."""
        plain = {key: np.asarray(value) for key, value in arrays.items()}
        self._write(
            f"{name}.npz", lambda file: np.savez_compressed(file, allow_pickle=False, **plain)
        )

    def _write_json(self, name: str, content: Any) -> None:
        text = json.dumps(content, indent=2, sort_keys=True, allow_nan=False, ensure_ascii=False)
        self._write_text(name, f"{text}\n")

    def _write_text(self, name: str, text: str) -> None:
        self._write(name, lambda file: file.write(text.encode()))

    def _write(self, name: str, write: Callable[[BinaryIO], Any]) -> None:
        write_atomically(self.path / name, write)


def create(scenario: Scenario, options: Options) -> RunFolder:
    """Make the folder of a run, in which nothing is written yet.

    Args:
        scenario: of the run.
        options: of the command, which name the folder.

    Raises:
        ScenarioError: when the folder cannot be made or written to, and when the run would
            overwrite a scenario that no run has written.
    """
    text = to_toml(scenario)
    folder = options.folder
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
        _refuse_to_overwrite(text, options)
        _tell_replacement(text, folder)
    except OSError as error:
        raise unwritable(folder, error) from None
    return RunFolder(folder, text, _describe(text, options))


def unwritable(folder: Path, error: OSError, option: str = "--out") -> ScenarioError:
    """Return the one line that refuses a folder that cannot be written to."""
    problem = f"cannot be written to ({error.strerror})"
    return refusal("command line", option, str(folder), problem, "name a folder you may write to")


def _refuse_to_overwrite(text: str, options: Options) -> None:
    """Refuse a folder where a file would be lost that users may have written."""
    folder = options.folder
    for path in options.scenario_files:
        in_folder = path.resolve().parent == folder.resolve() and path.name in SCENARIOS
        if in_folder and path.read_text() != text:
            problem = f"the run would overwrite {path}, which it reads"
            raise refusal("command line", "--out", str(folder), problem, "name another folder")
    path = folder / "scenario.toml"
    if path.exists() and path.read_bytes() != text.encode() and not _is_of_a_run(path):
        problem = f"the run would overwrite {path}, which no run has written"
        raise refusal("command line", "--out", str(folder), problem, "name another folder")


def _tell_replacement(text: str, folder: Path) -> None:
    """Say on the standard error that the run of another scenario is about to be replaced."""
    path = folder / "scenario.toml"
    if not path.exists() or path.read_bytes() == text.encode():
        return
    command = read_table(folder / "manifest.json").get("command_line")
    print(
        f"{folder}/: replaces the run of another scenario ({command}); --out keeps both",
        file=sys.stderr,
    )


def _is_of_a_run(path: Path) -> bool:
    """Tell whether the manifest beside a scenario.toml is that of the run that wrote it."""
    try:
        manifest = json.loads((path.parent / "manifest.json").read_bytes())
        return manifest["scenario_sha256"] == hashlib.sha256(path.read_bytes()).hexdigest()
    except (OSError, ValueError, LookupError, TypeError, RecursionError):
        return False


def identity(scenario: Scenario, options: Options, names: Iterable[str]) -> dict[str, Any]:
    """Return all that determines the numbers of a run: scenario, seed, the named options, code,
    packages, device."""
    import jax

    recording = scenario.slip.recording if scenario.slip.process == "recorded" else ""
    return {
        "scenario": msgspec.to_builtins(scenario),
        "reference_file_sha256": _hash_named(scenario.reference.file),
        "slip_recording_sha256": _hash_named(recording),
        "seed": options.seed,
        **{name: getattr(options, name) for name in names},
        "source_sha256": source_hashes(),
        "packages": {name: version(name) for name in COMPUTING_PACKAGES},
        "backend": jax.default_backend(),
        "bits": jax.dtypes.canonicalize_dtype(float).itemsize * 8,
    }


def _describe(scenario_text: str, options: Options) -> dict[str, Any]:
    """Return the manifest of a run that starts now."""
    jax = sys.modules.get("jax")
    return {
        "title": _name_run(options),
        "command_line": command_line(options),
        "seed": options.seed,
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "python": platform.python_version(),
        "packages": {name: version(name) for name in PACKAGES},
        "platform": {
            "system": platform.platform(),
            "machine": platform.machine(),
            "cpus": os.cpu_count(),
        },
        "devices": [str(device) for device in jax.devices()] if jax else [],
        "scenario_sha256": hashlib.sha256(scenario_text.encode()).hexdigest(),
        "source_sha256": source_hashes(),
        "git_commit": _find_commit(),
    }


def _name_run(options: Options) -> str:
    """Name a run: its command, and its scenario where it has one."""
    return f"{options.command}, scenario {options.label}" if options.label else options.command


def source_hashes() -> dict[str, str]:
    """Return the SHA-256 of the code, by package."""
    return {name: _hash_folder(_package_folder(name), "*.py") for name in ("jaxtube", "sets")}


def version(package: str) -> str | None:
    """Return the installed version of a package."""
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None


def _hash_named(name: str) -> str:
    """Return the SHA-256 of what a key names, nothing where it names nothing."""
    return _hash_path(Path(name)) if name else ""


def _hash_path(path: Path) -> str:
    """Return the SHA-256 of a file, or of all files in a folder."""
    if path.is_dir():
        return _hash_folder(path, "*")
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _package_folder(name: str) -> Path:
    spec = importlib.util.find_spec(name)
    assert spec and spec.origin
    return Path(spec.origin).parent


def _hash_folder(folder: Path, pattern: str) -> str:
    """Return the SHA-256 of the files in a folder and below whose names match."""
    digest = hashlib.sha256()
    for path in sorted(folder.rglob(pattern)):
        if path.is_file():
            digest.update(f"{path.relative_to(folder).as_posix()}\0".encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()


def _find_commit() -> str | None:
    """Name the commit of a source checkout, with "-dirty" when files differ from it; None for an
    installed package."""
    root = _package_folder("jaxtube").parent
    if not (root / ".git").exists():
        return None
    describe = ["describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]
    command = ["git", "-C", str(root), *describe]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return None


def _make_plain(value: Any) -> Any:
    """Reduce a value to what JSON holds."""
    if isinstance(value, Mapping):
        return {str(key): _make_plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_make_plain(entry) for entry in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, str | int):
        return value
    if hasattr(value, "tolist"):
        return _make_plain(value.tolist())
    raise TypeError(
        f"metric {value!r}: neither number, text, list nor mapping; convert it before it is saved"
    )
