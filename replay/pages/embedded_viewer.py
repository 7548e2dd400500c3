"""The Rerun viewer and a recording inside a page: it opens from a file and talks to no network.

The viewer is two files, a script and its WebAssembly, both within the installed SDK; its own server hands them out, bound
to this machine and for as long as that takes. A browser lets no page that was opened from a file load its neighbours, so
both are packed (gzip, base64) into the page, and unpacked when the reader opens the replay: until then the page is as
light to show as one without. The recording goes to the viewer through a channel, as bytes.
"""

from __future__ import annotations

import base64
import gzip
import os
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from socket import AF_INET, SOCK_STREAM, socket

VIEWER_POLICY = (
    "default-src 'none'; img-src data: blob:; style-src 'unsafe-inline'; font-src data:; "
    "script-src 'unsafe-inline' 'wasm-unsafe-eval'; worker-src blob:; media-src blob:; connect-src data: blob:"
)
"""Content security policy: what is in the page may run, and nothing may be asked of any network."""
START_S = 30.0
"""Within which the viewer's server answers, on a machine that has other work besides."""
COMPRESSION = 6
"""Of gzip: 9 takes three times as long for one per cent less."""

VIEWER_PLACE = """<div class="screen" id="replay">
<style>
#replay button { font: inherit; padding: .5rem 1rem; border: 1px solid var(--rule); background: var(--wash); cursor: pointer; }
#replay canvas { display: block; width: 100%; height: min(80vh, 46rem); background: #0d1011; }
@media (min-width: 60rem) { #replay.open { width: min(94vw, 90rem); margin-left: calc(50% - min(47vw, 45rem)); } }
</style>
<p><button type="button" id="replay-start">Open the replay</button></p>
<p class="key" id="replay-told">The viewer is in this page; it starts in a few seconds and needs WebGL or WebGPU.</p>
</div>"""
"""Where the viewer appears."""

SCRIPT = """<script>
(() => {
  const start = document.getElementById("replay-start"), told = document.getElementById("replay-told");
  const packed = (id) => Uint8Array.from(atob(document.getElementById(id).textContent), (c) => c.charCodeAt(0));
  const unpacked = (id) =>
    new Response(new Blob([packed(id)]).stream().pipeThrough(new DecompressionStream("gzip")));
  start.addEventListener("click", async () => {
    start.disabled = true;
    // The viewer tells its makers that it was started, and asks them for a newer one. It gets an empty answer from here.
    window.fetch = async () => new Response(null, { status: 204 });
    told.textContent = "Unpacking the viewer…";
    try {
      const script = document.createElement("script");
      script.textContent = await unpacked("viewer-script").text();
      document.head.append(script);
      await wasm_bindgen({ module_or_path: await unpacked("viewer-code").arrayBuffer() });
      const canvas = document.createElement("canvas");
      canvas.id = "replay-canvas";
      document.getElementById("replay").append(canvas);
      document.getElementById("replay").classList.add("open");
      const viewer = new wasm_bindgen.WebHandle({
        url: [], hide_welcome_screen: true, persist: false, enable_history: false, notebook: false, theme: "dark",
        panel_state_overrides: { top: "Hidden", blueprint: "Hidden", selection: "Hidden" },
      });
      await viewer.start(canvas);
      viewer.open_channel("throw", "throw");
      viewer.send_rrd_to_channel("throw", packed("viewer-recording"));
      viewer.close_channel("throw");
      start.remove();
      told.textContent = "";
      document.getElementById("replay").dataset.state = "started";
    } catch (error) {
      told.textContent = "The replay could not be started: " + error;
    }
  });
})();
</script>"""


def viewer_html(recording: Path) -> str:
    """The viewer, the recording and what starts them, for the end of a page that has a PLACE.

    Raises OSError where the recording cannot be read or the installed SDK hands out no viewer.
    """
    script, code = viewer_files()
    return "\n".join(
        [
            _packed("viewer-script", gzip.compress(script, COMPRESSION, mtime=0)),
            _packed("viewer-code", _compressed(code)),
            _packed("viewer-recording", recording.read_bytes()),
            SCRIPT,
        ]
    )


@lru_cache(maxsize=1)
def viewer_files() -> tuple[bytes, bytes]:
    """The web viewer of the installed SDK: its script and its WebAssembly. Raises OSError where it has none."""
    with _server() as address:
        script, code = _fetched(f"{address}/re_viewer.js"), _fetched(f"{address}/re_viewer_bg.wasm")
    if not code.startswith(b"\0asm"):
        raise OSError("the installed rerun-sdk hands out no web viewer; wanted one with it, as its wheels have")
    return script, code


@lru_cache(maxsize=1)
def _compressed(code: bytes) -> bytes:
    """The code packed, which takes seconds, once for all pages of a run."""
    return gzip.compress(code, COMPRESSION, mtime=0)


@contextmanager
def _server() -> Iterator[str]:
    """The address of a server of the viewer, on this machine alone."""
    ports = _free_port(), _free_port()
    # Without a file to show it would wait for a program to connect; nothing does, and it is stopped in a moment.
    command = [sys.executable, "-m", "rerun", "--serve-web", "--bind", "127.0.0.1"]
    command += ["--web-viewer-port", str(ports[0]), "--port", str(ports[1])]
    quiet = {**os.environ, "RUST_LOG": "off", "DO_NOT_TRACK": "1"}
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=quiet) as server:
        try:
            _wait_for(server, ports[0])
            yield f"http://127.0.0.1:{ports[0]}"
        finally:
            server.terminate()


def _free_port() -> int:
    with socket(AF_INET, SOCK_STREAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _wait_for(server: subprocess.Popen[bytes], port: int) -> None:
    """Raises OSError where nothing answers on the port."""
    until = time.monotonic() + START_S
    while time.monotonic() < until and server.poll() is None:
        with socket(AF_INET, SOCK_STREAM) as probe:
            probe.settimeout(1.0)
            if probe.connect_ex(("127.0.0.1", port)) == 0:
                return
        time.sleep(0.05)
    raise OSError(f"the viewer of rerun-sdk did not start within {START_S:g} s, so it cannot be put into the page")


def _fetched(address: str) -> bytes:
    # No proxy of the environment stands between this machine and itself.
    opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
    try:
        with opener.open(address, timeout=START_S) as answer:
            return bytes(answer.read())
    except urllib.error.URLError as error:
        raise OSError(f"the viewer of rerun-sdk could not be read from {address} ({error.reason})") from error


def _packed(name: str, data: bytes) -> str:
    """Bytes as text that the browser neither runs nor shows."""
    return f'<script type="text/plain" id="{name}">{base64.b64encode(data).decode("ascii")}</script>'
