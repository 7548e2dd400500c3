"""`diethrow watch`: the loop of a laboratory. A clip that the camera has finished is analysed, with one scene as a template.

Built on `batch`: each clip gets a scene file of its own, and the batch of all is continued whenever a clip is complete. So
nothing is kept but scenes and finished folders, and after Ctrl-C or a power cut the same command goes on. `index.html` grows by a
row and a small stroboscope a throw; after every N throws their joint fit follows.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from html import escape
from pathlib import Path

from ...files.analysis_folder import read_analysis
from ...files.outputs import whole_file
from ...files.scene import read_scene
from ...files.settings import SceneError, read_toml
from ...model.errors import DiethrowError, InputError
from ...replay.elements import motions_of
from ...replay.figures import stroboscope
from ...replay.pages import whole_page
from ..clip.batch import Batch, Result, Standing, run_batch
from ..clip.footage import clip_of_analysis
from ..clip.joint_fit import fit_tracks
from ..clip.new_scene import role_of, toml_text
from ..clip.run_options import USUAL_OPTIONS, RunOptions

POLL_S = 2.0
"""Time between two looks at the folder: a file that has not changed meanwhile is finished."""
FEWEST_FOR_JOINT_FIT = 2
"""Throws with a bounce."""
PATH_LINE = re.compile(r"^(\s*path\s*=\s*).*$", re.MULTILINE)
CLIP_TABLE = re.compile(r"^\[clip\].*?(?=^\[|\Z)", re.MULTILINE | re.DOTALL)


@dataclass(frozen=True)
class Watched:
    """What a look at the folder led to."""

    batch: Batch
    new: int
    """Clips that were finished since the look before."""
    joint_fit: Path | None
    """The folder of the joint fit, where one was made."""
    notices: tuple[str, ...]


@dataclass
class _Seen:
    """Files as they were at the look before, and what they are."""

    sizes: dict[Path, tuple[int, int]] = field(default_factory=dict)
    films: dict[tuple[Path, int, int], bool] = field(default_factory=dict)


def watch(
    folder: Path,
    template: Path,
    out: Path,
    *,
    options: RunOptions = USUAL_OPTIONS,
    joint_every: int = 0,
    poll_s: float = POLL_S,
    looks: int | None = None,
    executor: Executor | None = None,
    progress: Callable[[Standing], None] = lambda standing: None,
    reported: Callable[[Watched], None] = lambda watched: None,
    sleep: Callable[[float], None] = time.sleep,
) -> None:
    """Analyse every clip that appears in a folder, until Ctrl-C or for a number of `looks`.

    `template` is a scene; each clip gets a copy of it with its own path, which stays as it is once it is there. After every
    `joint_every` throws (0: never) the joint fit of all is written to `out/joint`. Raises InputError without the folder, and
    SceneError for a template that is no scene.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: there is no such folder; wanted the one that the camera saves to")
    text = template.read_text(encoding="utf-8") if template.is_file() else ""
    if not CLIP_TABLE.search(text):
        raise InputError(f"{template}: has no [clip] table; wanted a scene for all clips of the folder")
    seen, done, fitted = _Seen(), 0, 0
    while looks is None or looks > 0:
        scenes = [_scene_for(clip, template, text) for clip in _finished_clips(folder, seen)]
        if len(scenes) > done:
            batch = run_batch(
                scenes, out, executor=executor, workers=1, options=options, allow_outside=True, progress=progress
            )
            joint: Path | None = None
            notices: list[str] = []
            if joint_every and len(batch.results) // joint_every > fitted // joint_every:
                joint, notices = _joint_fit(scenes, batch, template, out)
                fitted = len(batch.results)
            _write_index(folder, scenes, batch, out, joint or _existing(out / "joint"))
            reported(Watched(batch, len(scenes) - done, joint, tuple(notices)))
            done = len(scenes)
        looks = None if looks is None else looks - 1
        if looks != 0:
            sleep(poll_s)


def _finished_clips(folder: Path, seen: _Seen) -> list[Path]:
    """The films of a folder that have not changed since the look before, in the order in which they were finished."""
    found: list[tuple[int, Path]] = []
    for path in sorted(folder.iterdir()):
        if path.name.startswith(".") or not path.is_file():
            continue
        status = path.stat()
        now = (status.st_size, status.st_mtime_ns)
        same, seen.sizes[path] = seen.sizes.get(path) == now, now
        if same and status.st_size and _is_film(path, now, seen):
            found.append((status.st_mtime_ns, path))
    return [path for _, path in sorted(found)]


def _is_film(path: Path, now: tuple[int, int], seen: _Seen) -> bool:
    key = (path, *now)
    if key not in seen.films:
        # Of a header and its pixels the header is the film.
        whole = not any(path.with_suffix(suffix).exists() for suffix in (".cih", ".cihx")) or path.suffix in (
            ".cih",
            ".cihx",
        )
        seen.films[key] = whole and role_of(path).role == "clip"
    return seen.films[key]


def _scene_for(clip: Path, template: Path, text: str) -> Path:
    """The scene file of a clip, beside the template, so that its other files are found from there."""
    line = f"path = {toml_text(_relative(clip, template.parent))}"
    path = template.parent / f"{clip.stem}.toml"
    # Two clips may have one name and two endings, and one may be called as the template.
    if path == template or (path.exists() and not _is_scene_of(path, clip)):
        path = template.parent / f"{clip.stem}_{clip.suffix[1:]}.toml"
    if path.exists():
        return path
    table = CLIP_TABLE.search(text)
    assert table is not None
    own = PATH_LINE.sub(lambda _: line, table.group(0), count=1)
    if own == table.group(0):
        own = table.group(0).replace("[clip]", f"[clip]\n{line}", 1)
    with whole_file(path) as file:
        file.write_text(text[: table.start()] + own + text[table.end() :], encoding="utf-8")
    return path


def _is_scene_of(scene: Path, clip: Path) -> bool:
    """Whether a scene file names a clip; one that is damaged is left to the analysis, which says so."""
    try:
        named = read_toml(scene)[0]["clip"]["path"]
    except (SceneError, KeyError, TypeError):
        return True
    return (scene.parent / str(named)).resolve() == clip.resolve()


def _relative(path: Path, folder: Path) -> str:
    try:
        return path.resolve().relative_to(folder.resolve()).as_posix()
    except ValueError:
        return path.resolve().as_posix()


def _joint_fit(scenes: Sequence[Path], batch: Batch, template: Path, out: Path) -> tuple[Path | None, list[str]]:
    """The joint fit of all throws so far; None, with a sentence, where they do not make one."""
    folders = {Path(one.scene): out / one.folder for one in batch.results}
    tracks = [folders[scene] / "track_frames.csv" for scene in scenes if scene in folders]
    if len(tracks) < FEWEST_FOR_JOINT_FIT:
        return None, []
    try:
        found = fit_tracks(tracks, read_scene(scenes[0], allow_outside=True), out / "joint", force=True)
    except DiethrowError as error:
        return None, [f"no joint fit: {error}"]
    return found.folder, list(found.left_out)


def _existing(path: Path) -> Path | None:
    return path if path.is_dir() else None


def _write_index(folder: Path, scenes: Sequence[Path], batch: Batch, out: Path, joint: Path | None) -> None:
    """`index.html`: a row and a small stroboscope a throw, the last first."""
    (out / "pictures").mkdir(exist_ok=True)
    rows = []
    for one in reversed(batch.results):
        place = out / one.folder
        picture = out / "pictures" / f"{place.name}.png"
        if not picture.exists():
            _draw(place, picture)
        image = (
            f'<img src="pictures/{escape(picture.name)}" alt="{escape(place.name)}" height="90">'
            if picture.exists()
            else ""
        )
        name = f'<a href="{escape(place.name)}/report.html">{escape(place.name)}</a>'
        rows.append(
            f"<tr><td>{image}</td><td>{name}</td><td>{_chi(one)}</td><td>{one.bounces}</td><td>{escape(one.verdict)}</td></tr>"
        )
    failed = "".join(f"<li>{escape(Path(one.scene).stem)}: {escape(one.reason)}</li>" for one in batch.failures)
    parts = [
        f"<h1>{escape(folder.resolve().name)}</h1>",
        f"<p>{len(batch.results)} throws, {len(batch.failures)} failures; numbers in results.csv.</p>",
        '<p><a href="joint/fit.json">the joint fit of all</a></p>' if joint is not None else "",
        '<div class="wide"><table><tr><th></th><th>throw</th><th>χ (95 %)</th><th>bounces</th><th>verdict</th></tr>'
        + "".join(rows)
        + "</table></div>",
        f"<h2>Failures</h2><ul>{failed}</ul>" if failed else "",
    ]
    with whole_file(out / "index.html", force=True) as file:
        file.write_text(whole_page(folder.resolve().name, (part for part in parts if part)), encoding="utf-8")


def _draw(place: Path, picture: Path) -> None:
    """A small stroboscope of a throw; none where the clip shows too little for one."""
    found = read_analysis(place)
    clip, camera = clip_of_analysis(found), found.record.camera
    if clip is None or camera is None or not found.track.tracked.any():
        return
    from matplotlib.figure import Figure

    figure = Figure(figsize=(2.4, 2.4 * clip.height_px / clip.width_px), dpi=100)
    ax = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    stroboscope(ax, clip, camera, found.record.die.solid, motions_of(found.record))
    ax.set_axis_off()
    with whole_file(picture, force=True) as file:
        figure.savefig(file)


def _chi(one: Result) -> str:
    if one.chi is None:
        return "not determined"
    interval = "" if one.chi_low is None or one.chi_high is None else f" ({one.chi_low:.4f} to {one.chi_high:.4f})"
    return f"{one.chi:.4f}{interval}"
