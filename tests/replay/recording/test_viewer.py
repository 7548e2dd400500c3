"""The recording in the real viewer, natively and in a browser: every tab is drawn and no view complains; and whoever
looks at a throw is not watched meanwhile."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import replay_records as made
import viewers
from numpy.typing import NDArray
from rerun.experimental import ViewerClient

from diethrow.commands.results.viewer import LOOPBACK, silent_environment, viewer_options, viewer_program
from diethrow.replay.recording.several_throws import Source, join_recordings
from diethrow.replay.recording.throw_recording import write_recording

TABS = ["Replay", "Bounces", "Residuals", "Fit"]
HARMLESS = ("Software rasterizer", "adapter backend", "expect poor performance")
"""Said of drawing without a GPU."""
DRAWN = 0.02
"""Standard deviation of a picture that shows something; an empty window of the viewer has less than 0.01."""
BROWSER_DRAWN = 0.05
"""The same for the whole page: the dots of the viewer's waiting page have 0.008 and 0.018."""
CHANGED = 0.01
"""Mean difference of two pictures that show different tabs; playing on changes less than 0.002 of one."""


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("viewed") / "replay.rrd"
    write_recording(path, made.record())
    return path


@pytest.fixture(scope="module")
def joined(recording: Path) -> Path:
    other = recording.with_name("other.rrd")
    write_recording(other, made.record(title="another", simulated=made.track(2e-4, gaps=False)))
    path = recording.with_name("joined.rrd")
    join_recordings(path, [Source(recording, "one"), Source(other, "two")])
    return path


def native_pictures(client: ViewerClient) -> Iterator[tuple[str, NDArray[np.float32]]]:
    """Every tab by its name and as it is drawn, each once it differs from the one before."""
    before = np.zeros(1)
    for name, identity in viewers.tabs_of(client).items():

        def changed(identity: str = identity, before: NDArray[Any] = before) -> NDArray[np.float32] | None:
            viewers.show_tab(client, identity)
            drawn = viewers.picture(client.take_screenshot())
            return drawn if drawn.shape != before.shape or abs(drawn - before).mean() > CHANGED else None

        before = viewers.until(changed, f"tab {name} is drawn")
        yield name, before


@pytest.mark.parametrize("which", ["recording", "joined"])
def test_every_tab_is_drawn_and_no_view_complains(which: str, request: pytest.FixtureRequest, tmp_path: Path) -> None:
    with viewers.native_viewer([request.getfixturevalue(which)], tmp_path) as client:
        client.set_time("frame", sequence=made.FIRST_FRAME + 40, play_state="paused")
        names = []
        for name, drawn in native_pictures(client):
            names.append(name)
            assert drawn.std() > DRAWN, name
        assert names == TABS
        reports = [(view.name, report) for view in client.get_state().views for report in view.reports]
        assert reports == []
        said = [(e.level, e.message) for e in client.get_logs() if e.level in ("WARN", "ERROR")]
        assert [entry for entry in said if not any(word in entry[1] for word in HARMLESS)] == []


def test_the_viewer_opens_paused_at_the_first_frame(recording: Path, tmp_path: Path) -> None:
    with viewers.native_viewer([recording], tmp_path) as client:
        (shown,) = client.get_state().recordings
        assert (shown.current_timeline, shown.current_time) == ("frame", made.FIRST_FRAME)
        panel = client.get_blueprint().blueprint["/time_panel"]["TimePanelBlueprint"]
        assert panel["playback_speed"] == pytest.approx(1.0 / 50.0)
        assert panel["fps"] == pytest.approx(made.FPS)


def test_the_viewer_in_a_browser_draws_every_tab(recording: Path, tmp_path: Path) -> None:
    """Chromium reaches no other machine here: what the web viewer would fetch from elsewhere fails, and is left out."""
    with viewers.web_viewer(recording, tmp_path) as address, viewers.browser_page(tmp_path) as page:
        page.ask("Page.navigate", url=address)

        def drawn(before: NDArray[np.float32] | None = None) -> NDArray[np.float32] | None:
            page.listen(0.5)
            now = viewers.picture(page.screenshot())
            new = before is None or abs(now - before).mean() > CHANGED
            return now if now.std() > BROWSER_DRAWN and new else None

        before = viewers.until(drawn, "the page draws the recording")
        for name, x_px in zip(TABS[1:], (127, 214, 285), strict=True):
            page.click(x_px, 51)
            shown = before
            before = viewers.until(lambda shown=shown: drawn(shown), f"tab {name} is drawn")
        # Only what belongs to the recording: fonts, statistics and news of the viewer are what the network lacks here.
        wrong = [
            text for text in page.errors() if "ERR_NAME_NOT_RESOLVED" not in text and "Failed to fetch" not in text
        ]
        assert wrong == []


OUTSIDE = """
import fcntl, json, socket, struct, subprocess, sys, time

with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
    fcntl.ioctl(any_socket, 0x8914, struct.pack("16sh", b"lo", 0x1 | 0x40))  # SIOCSIFFLAGS: up and running
process = subprocess.Popen(sys.argv[1:], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
listening = set()
while process.poll() is None:
    for table in ("/proc/net/tcp", "/proc/net/tcp6"):
        for line in open(table).read().splitlines()[1:]:
            words = line.split()
            if words[3] == "0A":
                listening.add(words[1].split(":")[0])
    time.sleep(0.01)
counters = {}
lines = open("/proc/net/snmp").read().splitlines()
for names, values in zip(lines[::2], lines[1::2]):
    kind, names = names.split(": ")
    counters.update({f"{kind}.{n}": int(v) for n, v in zip(names.split(), values.split(": ")[1].split())})
counters.update({k: int(v) for k, v in (l.split() for l in open("/proc/net/snmp6"))})
went = counters["Ip.OutNoRoutes"] + counters["Udp.NoPorts"] + counters["Ip6OutNoRoutes"]
print(json.dumps({"status": process.returncode, "listening": sorted(listening), "tried": went}))
"""
"""Run in a network of its own, which has no way out: whoever tries one is counted by the kernel."""


def in_a_network_without_a_way_out(command: list[str], environment: dict[str, str]) -> dict[str, Any]:
    """The exit status of a command, the addresses that it listened on, and how often it tried to reach another machine."""
    unshare = ["unshare", "--net", "--map-root-user"]
    try:
        subprocess.run([*unshare, "true"], check=True, capture_output=True, timeout=30)
    except (OSError, subprocess.CalledProcessError) as error:
        viewers.missing(f"no network namespace can be made here ({error})")
    done = subprocess.run(
        [*unshare, sys.executable, "-c", OUTSIDE, *command],
        env=environment,
        capture_output=True,
        text=True,
        timeout=viewers.PATIENCE_S,
        check=True,
    )
    return dict(json.loads(done.stdout))


def looking(recording: Path, picture: Path) -> list[str]:
    """A viewer that loads a recording, takes its own picture, and ends."""
    options = ["--headless", "--window-size", "800x600", "--screenshot-to", str(picture)]
    return [*viewer_program(), *viewer_options(), *options, str(recording)]


def test_whoever_looks_at_a_throw_is_not_watched(recording: Path, tmp_path: Path) -> None:
    """The viewer tries to reach nobody, listens on the loopback interface alone, and writes nothing into the home folder."""
    home = tmp_path / "home"
    home.mkdir()
    environment = {**silent_environment(), "HOME": str(home)}
    for name in ("XDG_CONFIG_HOME", "XDG_DATA_HOME"):
        environment.pop(name, None)
    found = in_a_network_without_a_way_out(looking(recording, tmp_path / "seen.png"), environment)
    if not (tmp_path / "seen.png").exists():
        viewers.require_graphics()
        pytest.fail("the viewer took no picture of the recording")
    assert found["tried"] == 0
    little_endian = {"".join(reversed([f"{int(part):02X}" for part in LOOPBACK.split(".")]))}
    assert set(found["listening"]) == little_endian
    assert list(home.rglob("*.json")) == []


def test_the_viewer_left_to_itself_would_tell_others(recording: Path, tmp_path: Path) -> None:
    """Else the test above would say nothing. Here, too, nothing gets out."""
    environment = {k: v for k, v in silent_environment().items() if k != "CI" and "proxy" not in k.lower()}
    environment.update(HOME=str(tmp_path), XDG_CONFIG_HOME=str(tmp_path / "c"), XDG_DATA_HOME=str(tmp_path / "d"))
    found = in_a_network_without_a_way_out(looking(recording, tmp_path / "seen.png"), environment)
    if not (tmp_path / "seen.png").exists():
        viewers.require_graphics()
        pytest.fail("the viewer took no picture of the recording")
    assert found["tried"] > 0


def test_writing_a_recording_reaches_nobody(tmp_path: Path) -> None:
    script = (
        "import sys; sys.path.insert(0, sys.argv[1]); import replay_records as made; from pathlib import Path; "
        "from diethrow.replay.recording import write_recording; write_recording(Path(sys.argv[2]), made.record(clip=None))"
    )
    command = [sys.executable, "-c", script, str(Path(made.__file__).parent), str(tmp_path / "x.rrd")]
    environment = {k: v for k, v in silent_environment().items() if k != "CI" and "proxy" not in k.lower()}
    found = in_a_network_without_a_way_out(command, {**environment, "HOME": str(tmp_path)})
    assert found == {"status": 0, "listening": [], "tried": 0}
