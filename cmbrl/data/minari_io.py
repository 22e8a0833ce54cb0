"""Logs as Minari datasets, a public format. Works offline; nothing is downloaded.

A dataset is a folder with ``data/main_data.hdf5`` and ``data/metadata.json`` (Minari 0.5, hdf5 format). An episode of
T transitions is written as T+1 observations ``{"qpos": (nq,), "qvel": (nv,)}``, T actions (nu,), and zero rewards,
because a log has none. The metadata has the time step, names, source under "cmbrl", with a
digest of the arrays. Other datasets can be read if their observations or infos contain raw
``qpos`` and ``qvel``; Gymnasium's observation vectors omit x and are clipped.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any, cast

import numpy as np

from cmbrl.data.fields import ROWS, Fields
from cmbrl.data.splitting import follows
from cmbrl.errors import UserError
from cmbrl.files import CHECKSUM, atomic_path, check_writable, checksum, record_text
from cmbrl.text import shortened

KEY = "cmbrl"
_ABOUT = {"dt": "dt", "joints": "joint_names", "actuators": "actuator_names", "source": "source"}  # there: here


def root_path(dataset_id: str) -> Path:
    """Folder of a dataset in Minari's own root (MINARI_DATASETS_PATH, or ~/.minari/datasets).

    Raises UserError if the id is not Minari's ``(NAMESPACE/)NAME-vN``, or Minari is missing.
    """
    _minari()
    from minari.dataset.minari_dataset import DATASET_ID_RE
    from minari.storage.datasets_root_dir import get_dataset_path

    match = DATASET_ID_RE.fullmatch(dataset_id)
    if match is None or match.group("version") is None:
        raise UserError(f"minari:{dataset_id}: not a Minari id; write minari:NAME-v0 or minari:NAMESPACE/NAME-v0")
    return Path(get_dataset_path(dataset_id))


def check_new(folder: Path) -> None:
    """Raises UserError if the folder exists or cannot be written, or Minari is missing; writes nothing."""
    _minari()
    if folder.exists():
        raise UserError(f"{folder}: already exists; remove it or choose another name")
    check_writable(folder)


def write(data: Fields, folder: Path, dataset_id: str | None = None) -> None:
    """Writes ``data`` as a dataset in ``folder``, completely or not at all; an episode with gaps becomes several.

    ``dataset_id`` is Minari's name; default: the folder's name, with version 0 if it has none. Raises UserError if the
    folder exists or cannot be written, or Minari is missing.
    """
    check_new(folder)
    folder = folder.absolute()  # Minari joins relative paths twice
    rows = len(data["q"])
    if rows == 0:
        raise UserError(f"{folder}: the log is empty; Minari needs at least one transition")
    from gymnasium.spaces import Box, Dict
    from minari.dataset.minari_storage import MinariStorage

    def space(columns: int) -> Box:
        return Box(-np.inf, np.inf, (columns,), np.float64)

    starts = np.concatenate([[0], np.flatnonzero(~follows(data)) + 1])
    ends = np.concatenate([starts[1:], [rows]])
    episodes = [slice(int(a), int(b)) for a, b in zip(starts, ends, strict=True)]
    if dataset_id is None:
        dataset_id = folder.name if folder.name.rpartition("-v")[2].isdigit() else f"{folder.name}-v0"
    about = {key: data[name] for key, name in _ABOUT.items()}  # type: ignore[literal-required]
    parts = [{name: data[name][rows] for name in ROWS} for rows in episodes]  # type: ignore[literal-required]
    about = {**about, "episodes": len(episodes), "digest": _digest(parts)}
    with atomic_path(folder) as temporary:
        (temporary / "data").mkdir(parents=True)
        storage = MinariStorage.new(
            temporary / "data",
            observation_space=Dict({"qpos": space(data["q"].shape[1]), "qvel": space(data["v"].shape[1])}),
            action_space=space(data["u"].shape[1]),
            data_format="hdf5",
        )
        storage.update_metadata(
            {
                "dataset_id": dataset_id,
                "minari_version": _minari().__version__,
                "algorithm_name": "log",
                "total_steps": rows,
                "total_episodes": len(episodes),
                KEY: record_text(about),
            }
        )
        (temporary / "data" / "main_data.hdf5").write_bytes(_hdf5(data, episodes))
        storage.update_metadata({"dataset_size": storage.get_size()})


def _hdf5(data: Fields, episodes: Sequence[slice]) -> bytes:
    """The content of ``main_data.hdf5``, made in memory: HDF5 crashes the process where the disk is full."""
    import h5py

    content = BytesIO()
    with h5py.File(content, "w") as file:
        for number, rows in enumerate(episodes):
            group = file.create_group(f"episode_{number}", track_order=True)
            length = rows.stop - rows.start
            group.attrs["id"], group.attrs["total_steps"] = number, length
            arrays = {
                "observations/qpos": np.concatenate([data["q"][rows], data["q_next"][rows][-1:]]),
                "observations/qvel": np.concatenate([data["v"][rows], data["v_next"][rows][-1:]]),
                "actions": data["u"][rows],
                "rewards": np.zeros(length),
                "terminations": np.zeros(length, dtype=bool),
                "truncations": np.arange(length) == length - 1,
            }
            for name, array in arrays.items():
                group.create_dataset(name, data=array, chunks=True, maxshape=(None, *array.shape[1:]))
            group.create_group("infos")
    return content.getvalue()


def read(path: Path) -> Fields:
    """Reads the dataset in the folder ``path``, or the one that the .hdf5 file ``path`` belongs to.

    Raises UserError if it is not a dataset, is damaged or empty, or lacks raw states or a time step.
    """
    minari = _minari()
    folder = (path if path.is_dir() else path.parent).absolute()
    folder = folder / "data" if (folder / "data").is_dir() else folder
    if not (folder / "metadata.json").is_file():
        raise UserError(f"{path}: not a Minari dataset (no metadata.json in {folder}); check the path")
    try:
        dataset = minari.MinariDataset(folder)
        stored = [_arrays(path, episode) for episode in dataset.iterate_episodes()]
        metadata = dict(dataset.storage.metadata)
    except UserError:
        raise
    except Exception as error:  # Minari does not check what it reads, so anything may come
        raise UserError(
            f"{path}: not readable as a Minari dataset ({shortened(repr(error), 200)}); record it again"
        ) from None
    stored = [arrays for arrays in stored if len(arrays["u"])]
    if not stored:
        raise UserError(f"{path}: the log is empty; record at least one transition")
    if KEY in metadata:
        about = _about(path, metadata[KEY], stored)
    else:
        about = {"dt": _environment_dt(path, dataset)}
    try:
        rows = {name: np.concatenate([arrays[name] for arrays in stored]) for name in stored[0]}
    except ValueError:
        raise UserError(f"{path}: its episodes have different numbers of columns; record one robot only") from None
    episode = np.repeat(np.arange(len(stored)), [len(arrays["u"]) for arrays in stored])
    source = {"source": {"minari": metadata.get("dataset_id", "")}}
    return cast(Fields, {**rows, "episode": episode, **source, **about})


def _about(path: Path, text: Any, stored: Sequence[Mapping[str, np.ndarray]]) -> dict[str, Any]:
    """What the metadata of a dataset of ours says about it; raises UserError if it is damaged, or not of ``stored``.

    Episodes may have been added by Minari. Without a checksum it is by hand, or of an older version.
    """
    try:
        about = json.loads(text)
    except (TypeError, ValueError, RecursionError):
        about = None
    if not isinstance(about, dict) or "dt" not in about:
        raise UserError(f"{path}: its metadata has no time step ({KEY}: dt); record the log again")
    told = about.pop(CHECKSUM, None)
    if told is not None and (told != checksum(about) or _digest(stored[: about["episodes"]]) != about["digest"]):
        raise UserError(f"{path}: damaged or changed since it was written; record the log again")
    names = [about.get(key, []) for key in ("joints", "actuators")]
    named = all(isinstance(x, list) and all(isinstance(name, str) for name in x) for x in names)
    if not named or not isinstance(about.get("source", {}), dict):
        raise UserError(f"{path}: its metadata ({KEY}: joints, actuators, source) is damaged; record the log again")
    return {here: about[there] for there, here in _ABOUT.items() if there in about}


def _digest(episodes: Sequence[Mapping[str, np.ndarray]]) -> str:
    """Of the arrays q, v, u, q_next, v_next of episodes, as float64."""
    arrays = (np.ascontiguousarray(part[name], dtype=np.float64) for part in episodes for name in ROWS)
    return checksum(b"".join(repr(array.shape).encode() + array.tobytes() for array in arrays))


def _minari() -> Any:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about formats that are not used here
            import h5py  # noqa: F401
            import minari
            import PIL  # noqa: F401  # minari's hdf5 extra needs Pillow without requiring it
    except ImportError as error:
        raise UserError(
            f"{error.name or 'minari'} is missing; Minari logs need it: pip install 'cmbrl[data]'"
        ) from None
    return minari


def _arrays(path: Path, episode: Any) -> dict[str, np.ndarray]:
    """q, v, u, q_next, v_next of one stored episode."""
    for place in (episode.observations, episode.infos):
        if isinstance(place, Mapping) and "qpos" in place and "qvel" in place:
            q, v = np.asarray(place["qpos"], dtype=np.float64), np.asarray(place["qvel"], dtype=np.float64)
            break
    else:
        raise UserError(
            f"{path}: neither observations nor infos contain qpos and qvel; record raw states, as `cmbrl record` does"
        )
    u = np.asarray(episode.actions, dtype=np.float64).reshape(len(episode.rewards), -1)
    if not len(q) == len(v) == len(u) + 1:
        raise UserError(
            f"{path}: episode {episode.id} has {len(q)} states for {len(u)} actions; one more state is needed"
        )
    return {"q": q[:-1], "v": v[:-1], "u": u, "q_next": q[1:], "v_next": v[1:]}


def _environment_dt(path: Path, dataset: Any) -> float:
    """Control step [s] of the environment of a dataset by others."""
    try:
        return float(dataset.recover_environment().unwrapped.dt)
    except Exception as error:  # an environment is foreign code, and may not be installed
        raise UserError(
            f"{path}: the dataset has no time step, and its environment does not start "
            f"({shortened(repr(error), 200)}); "
            "load it in Python and make Transitions with dt="
        ) from None
