"""The recording in the real viewer, natively and in a browser: every tab is drawn without a complaint, and the viewer
sends nothing to any other machine."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import replay_records as made
import viewers
from browser import opened, skip_or_fail
from numpy.typing import NDArray
from rerun.experimental import ViewerClient

from diethrow.commands.results.viewer import LOOPBACK, silent_environment, viewer_options, viewer_program
from diethrow.replay.recording.several_throws import Source, join_recordings
from diethrow.replay.recording.throw_recording import write_recording

TABS = ["Replay", "Bounces", "Residuals", "Fit"]
HARMLESS = ("Software rasterizer", "adapter backend", "expect poor performance")
"""Messages about drawing without a GPU."""
DRAWN = 0.02
"""Smallest standard deviation of an image with contents; an empty window of the viewer has less than 0.01."""
BROWSER_DRAWN = 0.05
"""The same for the whole page; the waiting page of the viewer has 0.008 and 0.018."""
CHANGED = 0.01
"""Smallest mean difference of two images of different tabs; playback changes one tab by less than 0.002."""
NO_NETWORK = ("ERR_NAME_NOT_RESOLVED", "ERR_PROXY_CONNECTION_FAILED", "Failed to fetch")
"""Errors of requests to other machines (fonts, statistics, news of the viewer), which cannot succeed here."""


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
    """Name and image of every tab, each as soon as it differs from the one before."""
    before = np.zeros(1)
    for name, identity in viewers.tabs_of(client).items():

        def changed(identity: str = identity, before: NDArray[Any] = before) -> NDArray[np.float32] | None:
            viewers.show_tab(client, identity)
            drawn = viewers.image_of(client.take_screenshot())
            return drawn if drawn.shape != before.shape or abs(drawn - before).mean() > CHANGED else None

        before = viewers.wait_for(changed, f"tab {name} is drawn")
        yield name, before


@pytest.mark.parametrize("which", ["recording", "joined"])
def test_every_tab_is_drawn_without_a_complaint(which: str, request: pytest.FixtureRequest, tmp_path: Path) -> None:
    with viewers.native_viewer([request.getfixturevalue(which)], tmp_path) as client:
        client.set_time("frame", sequence=made.FIRST_FRAME + 40, play_state="paused")
        names = []
        for name, drawn in native_pictures(client):
            names.append(name)
            assert drawn.std() > DRAWN, name
        assert names == TABS
        reports = [(view.name, report) for view in client.get_state().views for report in view.reports]
        assert reports == []
        messages = [(e.level, e.message) for e in client.get_logs() if e.level in ("WARN", "ERROR")]
        assert [entry for entry in messages if not any(word in entry[1] for word in HARMLESS)] == []


def test_the_viewer_opens_paused_at_the_first_frame(recording: Path, tmp_path: Path) -> None:
    with viewers.native_viewer([recording], tmp_path) as client:
        (shown,) = client.get_state().recordings
        assert (shown.current_timeline, shown.current_time) == ("frame", made.FIRST_FRAME)
        panel = client.get_blueprint().blueprint["/time_panel"]["TimePanelBlueprint"]
        assert panel["playback_speed"] == pytest.approx(1.0 / 50.0)
        assert panel["fps"] == pytest.approx(made.FPS)


def test_the_viewer_in_a_browser_draws_every_tab(recording: Path, tmp_path: Path) -> None:
    """Chromium reaches no other machine here; the errors of such requests are ignored."""
    width_px, height_px = viewers.WINDOW_PX
    with (
        viewers.web_viewer(recording, tmp_path) as address,
        opened(address, tmp_path / "browser", width_px=width_px, height_px=height_px) as page,
    ):

        def drawn(before: NDArray[np.float32] | None = None) -> NDArray[np.float32] | None:
            time.sleep(0.5)
            now = viewers.image_of(page.screenshot())
            new = before is None or abs(now - before).mean() > CHANGED
            return now if now.std() > BROWSER_DRAWN and new else None

        before = viewers.wait_for(drawn, "the page draws the recording")
        for name, x_px in zip(TABS[1:], (127, 214, 285), strict=True):
            page.click(x_px, 51)
            shown = before
            before = viewers.wait_for(lambda shown=shown: drawn(shown), f"tab {name} is drawn")
        assert [text for text in page.errors if not any(reason in text for reason in NO_NETWORK)] == []


COUNT_ATTEMPTS = """
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
attempts = counters["Ip.OutNoRoutes"] + counters["Udp.NoPorts"] + counters["Ip6OutNoRoutes"]
print(json.dumps({"status": process.returncode, "listening": sorted(listening), "tried": attempts}))
"""
"""Runs a command in a network namespace without a route to the outside; the kernel counts attempts to use one."""


def run_without_network(command: list[str], environment: dict[str, str]) -> dict[str, Any]:
    """The exit status of a command, the addresses on which it listened, and its attempts to reach another machine."""
    unshare = ["unshare", "--net", "--map-root-user"]
    try:
        subprocess.run([*unshare, "true"], check=True, capture_output=True, timeout=30)
    except (OSError, subprocess.CalledProcessError) as error:
        skip_or_fail(f"no network namespace can be made here ({error})")
    done = subprocess.run(
        [*unshare, sys.executable, "-c", COUNT_ATTEMPTS, *command],
        env=environment,
        capture_output=True,
        text=True,
        timeout=viewers.TIMEOUT_S,
        check=True,
    )
    return dict(json.loads(done.stdout))


def screenshot_command(recording: Path, image: Path) -> list[str]:
    """A viewer that loads a recording, takes a screenshot, and ends."""
    options = ["--headless", "--window-size", "800x600", "--screenshot-to", str(image)]
    return [*viewer_program(), *viewer_options(), *options, str(recording)]


def test_the_viewer_sends_nothing_and_listens_on_localhost_only(recording: Path, tmp_path: Path) -> None:
    """The viewer contacts no other machine, listens on localhost only, and writes nothing into the home folder."""
    home = tmp_path / "home"
    home.mkdir()
    environment = {**silent_environment(), "HOME": str(home)}
    for name in ("XDG_CONFIG_HOME", "XDG_DATA_HOME"):
        environment.pop(name, None)
    found = run_without_network(screenshot_command(recording, tmp_path / "shot.png"), environment)
    if not (tmp_path / "shot.png").exists():
        viewers.require_graphics()
        pytest.fail("the viewer took no picture of the recording")
    assert found["tried"] == 0
    little_endian = {"".join(reversed([f"{int(part):02X}" for part in LOOPBACK.split(".")]))}
    assert set(found["listening"]) == little_endian
    assert list(home.rglob("*.json")) == []


def test_the_viewer_with_its_own_defaults_contacts_other_machines(recording: Path, tmp_path: Path) -> None:
    """Otherwise the test above would prove nothing. Here, too, no request leaves the machine."""
    environment = {k: v for k, v in silent_environment().items() if k != "CI" and "proxy" not in k.lower()}
    environment.update(HOME=str(tmp_path), XDG_CONFIG_HOME=str(tmp_path / "c"), XDG_DATA_HOME=str(tmp_path / "d"))
    found = run_without_network(screenshot_command(recording, tmp_path / "shot.png"), environment)
    if not (tmp_path / "shot.png").exists():
        viewers.require_graphics()
        pytest.fail("the viewer took no picture of the recording")
    assert found["tried"] > 0


def test_writing_a_recording_contacts_no_other_machine(tmp_path: Path) -> None:
    script = (
        "import sys; sys.path.insert(0, sys.argv[1]); import replay_records as made; from pathlib import Path; "
        "from diethrow.replay.recording import write_recording; write_recording(Path(sys.argv[2]), made.record(clip=None))"
    )
    command = [sys.executable, "-c", script, str(Path(made.__file__).parent), str(tmp_path / "x.rrd")]
    environment = {k: v for k, v in silent_environment().items() if k != "CI" and "proxy" not in k.lower()}
    found = run_without_network(command, {**environment, "HOME": str(tmp_path)})
    assert found == {"status": 0, "listening": [], "tried": 0}
