"""Trackers on disk: one file with the arrays and a description of the settings, no pickle.

The file is an ``.npz`` archive: an entry ``scene.json`` (UTF-8 bytes) that says how the scene is
built up and with what settings, and one entry per array.
"""

from __future__ import annotations

import hashlib
import json
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import attrs
import numpy as np

from imm_tdoa.recording import _atomic
from imm_tdoa.reopening import Trust
from imm_tdoa.state import State, Taken
from imm_tdoa.statespace import StateSpace
from imm_tdoa.tracking.clutter import Clutter
from imm_tdoa.tracking.memory import Heard, Memory
from imm_tdoa.tracking.scene import Confirmed, Ended, Record, Scene
from imm_tdoa.tracking.settings import Settings
from imm_tdoa.tracking.standing import Standing

FORMAT = "imm-tdoa tracker 1"
KINDS = (Clutter, Confirmed, Ended, Heard, Memory, Record, Scene, Standing, State, Taken, Trust)
BY_NAME = {kind.__name__: kind for kind in KINDS}


def save(path: str | Path, settings: Settings, scene: Scene) -> None:
    """Write a scene and a description of the settings; the file appears whole or not at all."""
    arrays: dict[str, Any] = {}
    content = {
        "format": FORMAT,
        "settings": describe(settings),
        "scene": _packed(scene, arrays),
    }
    text = json.dumps(content, allow_nan=True).encode("utf-8")
    with _atomic.file(Path(path)) as draft, draft.open("wb") as out:
        arrays["scene.json"] = np.frombuffer(text, dtype=np.uint8)
        np.savez_compressed(out, **arrays)


def load(path: str | Path, settings: Settings) -> Scene:
    """Return the scene of a file.

    Raises
    ------
    ValueError
        No such file, no tracker's file, or one of a tracker with other settings; the message
        names the first that differs.
    """
    path = Path(path)
    if not path.is_file():
        raise ValueError(f"{path.name}: there is no such file")
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
        content = json.loads(arrays.pop("scene.json").tobytes().decode("utf-8"))
        known = content["format"]
    except (KeyError, OSError, TypeError, ValueError, zipfile.BadZipFile) as error:
        raise ValueError(f"{path.name}: expected a saved tracker: {error}") from error
    if known != FORMAT:
        raise ValueError(f"{path.name}: expected the format {FORMAT!r}, got {known!r}")
    here = json.loads(json.dumps(describe(settings)))
    place = _difference(content["settings"], here, "settings")
    if place is not None:
        raise ValueError(f"{path.name}: saved by a tracker with other settings: {place}")
    try:
        scene = _unpacked(content["scene"], arrays, settings.imm.space)
    except (KeyError, TypeError, IndexError, AttributeError) as error:
        raise ValueError(f"{path.name}: damaged: {error!r}") from error
    assert isinstance(scene, Scene)
    return scene


def describe(value: Any) -> Any:
    """Return what JSON can hold of a configuration: classes, numbers, fingerprints of arrays."""
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        if value.size <= 16:
            return value.tolist()
        digest = hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()
        return {"shape": list(value.shape), "sha256": digest[:32]}
    if isinstance(value, Mapping):
        return {str(k): describe(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [describe(v) for v in value]
    if attrs.has(type(value)):
        fields = {
            field.name: describe(getattr(value, field.name))
            for field in attrs.fields(type(value))
            if not field.name.startswith("_")
        }
        return {"class": type(value).__name__, **fields}
    if hasattr(value, "__dict__"):
        fields = {k: describe(v) for k, v in vars(value).items() if not k.startswith("_")}
        return {"class": type(value).__name__, **fields}
    return {"class": type(value).__name__}


def _difference(saved: Any, here: Any, place: str) -> str | None:
    """Say where two descriptions first differ; None where they do not."""
    if isinstance(saved, dict) and isinstance(here, dict):
        for key in [*saved, *(k for k in here if k not in saved)]:
            found = _difference(saved.get(key), here.get(key), f"{place}.{key}")
            if found is not None:
                return found
        return None
    if isinstance(saved, list) and isinstance(here, list) and len(saved) == len(here):
        for i, (a, b) in enumerate(zip(saved, here, strict=True)):
            found = _difference(a, b, f"{place}[{i}]")
            if found is not None:
                return found
        return None
    same = saved == here or (saved != saved and here != here)
    return None if same else f"{place} was {saved!r}, here it is {here!r}"


def _packed(value: Any, arrays: dict[str, Any]) -> Any:
    """Put the arrays of a scene aside, and return the rest of it for JSON."""
    if isinstance(value, np.ndarray):
        name = f"a{len(arrays)}"
        arrays[name] = value
        return {"array": name}
    if isinstance(value, StateSpace):
        return {"space": True}
    if isinstance(value, tuple):
        return {"tuple": [_packed(v, arrays) for v in value]}
    if isinstance(value, Mapping):
        return {"map": {str(k): _packed(v, arrays) for k, v in value.items()}}
    if type(value) in KINDS:
        fields = attrs.fields(type(value))
        return {
            "class": type(value).__name__,
            "fields": {f.name: _packed(getattr(value, f.name), arrays) for f in fields},
        }
    return value.item() if isinstance(value, np.generic) else value


def _unpacked(value: Any, arrays: Mapping[str, Any], space: StateSpace) -> Any:
    """Return what `_packed` took apart."""
    if not isinstance(value, dict):
        return value
    if "array" in value:
        return arrays[value["array"]]
    if "space" in value:
        return space
    if "tuple" in value:
        return tuple(_unpacked(v, arrays, space) for v in value["tuple"])
    if "map" in value:
        return {k: _unpacked(v, arrays, space) for k, v in value["map"].items()}
    kind: Any = BY_NAME[value["class"]]
    return kind(**{k: _unpacked(v, arrays, space) for k, v in value["fields"].items()})
