"""The folder of a run: what was asked, what came out, and what produced it.

    scenario.toml    the scenario with every key spelled out
    manifest.json    versions, platform, hashes of scenario and sources, command line, seed, date, git commit
    metrics.json     plain numbers, units in the key; there once the run is complete
    NAME.png, NAME.pdf, NAME.npz

Files appear complete or not at all.
"""

import hashlib
import importlib.metadata
import importlib.util
import json
import math
import os
import platform
import subprocess
import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, BinaryIO

import msgspec
import numpy as np

from jaxtube.experiments.options import Options, command_line
from jaxtube.experiments.run.atomic import write_atomically
from jaxtube.scenario import Scenario, to_toml
from jaxtube.scenario.refusal import refusal

PACKAGES = (
    "jaxtube",
    "jax",
    "jaxlib",
    "numpy",
    "scipy",
    "cvxpy-base",
    "clarabel",
    "msgspec",
    "matplotlib",
)


@dataclass(frozen=True)
class RunFolder:
    """The folder of one run; its methods write files into it."""

    path: Path

    def save_metrics(self, metrics: Mapping[str, Any]) -> None:
        """Write metrics.json with sorted keys; numbers that are not finite become null.

        Raises: TypeError for what is no number, text, list or mapping.
        """
        self._write_json("metrics.json", _plain(metrics))

    def save_figure(self, figure: Any, name: str) -> None:
        """Write a matplotlib figure as NAME.png and NAME.pdf; the same figure gives the same bytes."""
        self._write(f"{name}.png", lambda file: figure.savefig(file, format="png", dpi=200))
        undated = {"CreationDate": None}
        self._write(
            f"{name}.pdf", lambda file: figure.savefig(file, format="pdf", metadata=undated)
        )

    def save_json(self, name: str, content: Mapping[str, Any]) -> None:
        """Write NAME.json like metrics.json."""
        self._write_json(f"{name}.json", _plain(content))

    def save_arrays(self, name: str, **arrays: Any) -> None:
        """Write arrays as NAME.npz."""
        plain = {key: np.asarray(value) for key, value in arrays.items()}
        self._write(
            f"{name}.npz", lambda file: np.savez_compressed(file, allow_pickle=False, **plain)
        )

    def _write_json(self, name: str, content: Any) -> None:
        text = json.dumps(content, indent=2, sort_keys=True, allow_nan=False, ensure_ascii=False)
        self._write(name, lambda file: file.write(f"{text}\n".encode()))

    def _write(self, name: str, write: Callable[[BinaryIO], Any]) -> None:
        write_atomically(self.path / name, write)


def create(scenario: Scenario, options: Options) -> RunFolder:
    """Make the folder of a run with scenario.toml and manifest.json, and without the metrics of an
    earlier run.

    Raises: ScenarioError when the folder cannot be made or written to.
    """
    folder, text = RunFolder(options.folder), to_toml(scenario)
    try:
        folder.path.mkdir(parents=True, exist_ok=True)
        (folder.path / "metrics.json").unlink(missing_ok=True)
        folder._write("scenario.toml", lambda file: file.write(text.encode()))
        folder._write_json("manifest.json", _manifest(text, options))
    except OSError as error:
        problem = f"cannot be written to ({error.strerror})"
        raise refusal(
            "command line", "--out", str(folder.path), problem, "name a folder you may write to"
        ) from None
    return folder


def identity(scenario: Scenario, options: Options, names: Iterable[str]) -> dict[str, Any]:
    """Return all that determines the numbers of a run: scenario, seed, the named options, code,
    packages, device."""
    jax, file = sys.modules["jax"], scenario.reference.file
    return {
        "scenario": msgspec.to_builtins(scenario),
        "reference_file_sha256": hashlib.sha256(Path(file).read_bytes()).hexdigest()
        if file
        else "",
        "seed": options.seed,
        **{name: getattr(options, name) for name in names},
        "source_sha256": source_hashes(),
        "packages": {
            name: version(name) for name in ("jax", "jaxlib", "numpy", "scipy", "clarabel")
        },
        "backend": jax.default_backend(),
        "bits": jax.dtypes.canonicalize_dtype(float).itemsize * 8,
    }


def _manifest(scenario_text: str, options: Options) -> dict[str, Any]:
    return {
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
        "devices": [str(device) for device in sys.modules["jax"].devices()]
        if "jax" in sys.modules
        else [],
        "scenario_sha256": hashlib.sha256(scenario_text.encode()).hexdigest(),
        "source_sha256": source_hashes(),
        "git_commit": _git_commit(),
    }


def source_hashes() -> dict[str, str]:
    """Return the SHA-256 of the code, by package."""
    return {name: _source_hash(_package_folder(name)) for name in ("jaxtube", "sets")}


def version(package: str) -> str | None:
    """Return the installed version of a package."""
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None


def _package_folder(name: str) -> Path:
    spec = importlib.util.find_spec(name)
    assert spec and spec.origin
    return Path(spec.origin).parent


def _source_hash(folder: Path) -> str:
    digest = hashlib.sha256()
    for path in sorted(folder.rglob("*.py")):
        digest.update(f"{path.relative_to(folder).as_posix()}\0".encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()


def _git_commit() -> str | None:
    """Name the commit of a source checkout, with "-dirty" when files differ from it; None for an
    installed package."""
    root = _package_folder("jaxtube").parent
    if not (root / ".git").exists():
        return None
    describe = [
        "git",
        "-C",
        str(root),
        "describe",
        "--always",
        "--dirty",
        "--abbrev=40",
        "--exclude=*",
    ]
    try:
        return subprocess.run(describe, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return None


def _plain(value: Any) -> Any:
    """Reduce a value to what JSON holds."""
    if isinstance(value, Mapping):
        return {str(key): _plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, str | int):
        return value
    if hasattr(value, "tolist"):
        return _plain(value.tolist())
    raise TypeError(
        f"metric {value!r}: neither number, text, list nor mapping; convert it before it is saved"
    )
