// Plays a throw in its page: the die in 3D at the poses of the table `track.csv`, and its outline on the picture beside it.
"use strict";
(() => {
  const FIELD = 0.47; // half of the view's smaller side that the throw fills
  const DISTANCE = 4; // of the eye, in radii of what is seen: near enough for some perspective
  const TURN = 0.01; // radians that the view turns for each pixel of a drag
  const KEY_TURN = 0.1; // radians for each press of an arrow key
  const ZOOM = 1.2; // for each press of + or -
  const STEEPEST = 1.5; // radians of elevation, short of straight down, where the view would have no upright
  const LOWEST = 0.03; // radians of elevation, just above the table
  const NUMBERED = 9; // bounces with their number: the later ones of a long throw lie close together
  const MEASURED_WIDTH = 3.5, MODEL_WIDTH = 1.3; // pixels: where both agree, the model's line lies within the measured one
  const WIDEST = 0.08; // line of an edge, in the radius of the die as it is seen
  const SMALL = 0.07; // radius of a die in that of the whole throw below which the view follows it from the beginning
  const LIGHT = [0.36, -0.48, 0.8];
  const CORNER_UNITS = 8; // corners in the picture are stored in eighths of a pixel
  const UNKNOWN = -32768; // stored in the place of a corner that the camera does not see

  const bytes = (text) => Uint8Array.from(atob(text), (character) => character.charCodeAt(0)).buffer;
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const sum = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
  const difference = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
  const scaled = (a, factor) => [factor * a[0], factor * a[1], factor * a[2]];
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const unit = (a) => scaled(a, 1 / Math.hypot(...a));
  const mean = (points) => scaled(points.reduce(sum), 1 / points.length);

  // A vector turned by a unit quaternion (w, x, y, z).
  const turned = ([w, ...axis], vector) => {
    const across = scaled(cross(axis, vector), 2);
    return sum(sum(vector, scaled(across, w)), cross(axis, across));
  };

  // A notebook runs this once for each throw that it shows.
  for (const place of document.querySelectorAll(".player:not([data-frame])")) play(place);

  function play(place) {
    const data = JSON.parse(place.querySelector("script").textContent);
    const part = (name) => place.querySelector(`[data-part="${name}"]`);
    const canvas = part("view"), slider = part("time"), button = part("play"), speed = part("speed"), now = part("now");
    const pen = canvas.getContext("2d");
    const frames = new Int32Array(bytes(data.frame)), times = new Float32Array(bytes(data.time_ms));
    const motions = data.motions.map((motion) => ({
      name: motion.name,
      colour: motion.colour,
      poses: new Float32Array(bytes(motion.poses)),
      corners: motion.corners === null ? null : new Int16Array(bytes(motion.corners)),
      shown: true,
    }));
    const last = frames.length - 1;
    const view = { azimuth: data.view[0], elevation: data.view[1], zoom: 1, follow: false };
    let row = 0, started = null;

    // --- poses ---

    const positionOf = (motion, k) => Array.from(motion.poses.subarray(7 * k, 7 * k + 3));
    const isKnown = (motion, k) => Number.isFinite(motion.poses[7 * k]);
    const cornersOf = (motion, k) => {
      const quaternion = Array.from(motion.poses.subarray(7 * k + 3, 7 * k + 7)), place = positionOf(motion, k);
      return data.vertices.map((vertex) => sum(place, turned(quaternion, vertex)));
    };
    const size = Math.max(...data.vertices.map((vertex) => Math.hypot(...vertex)));
    const low = [Infinity, Infinity, 0], high = [-Infinity, -Infinity, 0];
    for (const motion of motions)
      for (let k = 0; k <= last; k++)
        if (isKnown(motion, k))
          positionOf(motion, k).forEach((value, axis) => {
            low[axis] = Math.min(low[axis], value - size);
            high[axis] = Math.max(high[axis], value + size);
          });
    low[2] = 0;
    const middle = scaled(sum(low, high), 0.5);
    // Of a sphere about the middle that holds every die, and the table below them.
    let extent = 0.5 * high[2];
    for (const motion of motions)
      for (let k = 0; k <= last; k++)
        if (isKnown(motion, k)) extent = Math.max(extent, size + Math.hypot(...difference(positionOf(motion, k), middle)));

    view.follow = part("follow").checked = size < SMALL * extent;

    // --- the view ---

    function camera() {
      const known = motions.find((motion) => motion.shown && isKnown(motion, row)) ?? motions[0];
      const follows = view.follow && isKnown(known, row);
      const target = follows ? positionOf(known, row) : middle;
      const radius = (follows ? 2.5 * size : extent) / view.zoom;
      const back = [
        Math.cos(view.elevation) * Math.cos(view.azimuth),
        Math.cos(view.elevation) * Math.sin(view.azimuth),
        Math.sin(view.elevation),
      ];
      const right = [-Math.sin(view.azimuth), Math.cos(view.azimuth), 0], up = cross(back, right);
      const width = canvas.clientWidth, height = canvas.clientHeight;
      const focal = FIELD * Math.min(width, height) * Math.sqrt(DISTANCE ** 2 - 1);
      const eye = sum(target, scaled(back, DISTANCE * radius));
      return {
        eye,
        on: (point) => {
          const from = difference(point, eye), away = Math.max(-dot(from, back), 0.05 * radius);
          return [0.5 * width + (focal * dot(from, right)) / away, 0.5 * height - (focal * dot(from, up)) / away];
        },
      };
    }

    const trace = (points) => {
      points.forEach(([x, y], k) => (k ? pen.lineTo(x, y) : pen.moveTo(x, y)));
    };

    function draw() {
      const style = getComputedStyle(place);
      const ink = style.color, [soft, rule] = ["--player-soft", "--player-rule"].map((name) => style.getPropertyValue(name));
      const density = window.devicePixelRatio || 1;
      const width = Math.round(density * canvas.clientWidth), height = Math.round(density * canvas.clientHeight);
      if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
      pen.setTransform(density, 0, 0, density, 0, 0);
      pen.clearRect(0, 0, canvas.clientWidth, canvas.clientHeight);
      pen.lineJoin = pen.lineCap = "round";
      const seen = camera();
      drawTable(seen, rule);
      drawImpacts(seen, ink, soft);
      for (const motion of motions) if (motion.shown) drawPath(seen, motion);
      motions.forEach((motion, k) => {
        if (motion.shown && isKnown(motion, row)) drawDie(seen, motion, k === 0 || !motions[0].shown);
      });
    }

    function drawTable(seen, rule) {
      const step = data.grid_m;
      const bounds = [0, 1].map((axis) => [Math.floor(low[axis] / step) * step, Math.ceil(high[axis] / step) * step]);
      pen.strokeStyle = rule;
      pen.lineWidth = 1;
      pen.beginPath();
      for (const axis of [0, 1])
        for (let at = bounds[axis][0]; at <= bounds[axis][1] + 0.5 * step; at += step)
          trace(bounds[1 - axis].map((end) => seen.on(axis === 0 ? [at, end, 0] : [end, at, 0])));
      pen.stroke();
    }

    function drawImpacts(seen, ink, soft) {
      pen.font = "12px system-ui, sans-serif";
      pen.textAlign = "left";
      pen.textBaseline = "bottom";
      data.impacts.forEach((impact, k) => {
        if (impact.place_m === null) return;
        const [x, y] = seen.on([...impact.place_m, 0]);
        const past = impact.time_ms <= times[row];
        pen.strokeStyle = pen.fillStyle = past ? ink : soft;
        pen.lineWidth = past ? 2 : 1;
        pen.beginPath();
        trace([[x - 4, y - 4], [x + 4, y + 4]]);
        trace([[x - 4, y + 4], [x + 4, y - 4]]);
        pen.stroke();
        if (k < NUMBERED) pen.fillText(String(k + 1), x + 6, y - 2);
      });
    }

    function drawPath(seen, motion) {
      pen.strokeStyle = motion.colour;
      pen.globalAlpha = 0.5;
      pen.lineWidth = 1.5;
      pen.beginPath();
      for (let k = 0, open = false; k <= last; k++) {
        if (!isKnown(motion, k)) open = false;
        else {
          const [x, y] = seen.on(positionOf(motion, k));
          open ? pen.lineTo(x, y) : pen.moveTo(x, y);
          open = true;
        }
      }
      pen.stroke();
      pen.globalAlpha = 1;
    }

    // The die as a solid with the numbers of its faces, or only its visible edges.
    function drawDie(seen, motion, solid) {
      const corners = cornersOf(motion, row);
      const faces = data.faces.map((face) => face.map((corner) => corners[corner]));
      const normals = faces.map((face) => unit(cross(difference(face[1], face[0]), difference(face[2], face[0]))));
      if (solid) {
        pen.fillStyle = "rgba(0, 0, 0, 0.18)";
        pen.beginPath();
        // The faces that look up cover the shadow once.
        faces.forEach((face, k) => {
          if (normals[k][2] > 0) trace(face.map(([x, y]) => seen.on([x, y, 0])));
        });
        pen.fill();
      }
      pen.strokeStyle = motion.colour;
      const [x, y] = seen.on(positionOf(motion, row));
      const radius = Math.max(...corners.map(seen.on).map(([cx, cy]) => Math.hypot(cx - x, cy - y)));
      pen.lineWidth = Math.min(motion === motions[0] ? MEASURED_WIDTH : MODEL_WIDTH, WIDEST * radius);
      faces.forEach((face, k) => {
        if (dot(normals[k], difference(seen.eye, face[0])) <= 0) return;
        pen.beginPath();
        trace(face.map(seen.on));
        pen.closePath();
        if (solid) {
          pen.fillStyle = `hsl(210 14% ${66 + 28 * Math.max(0, dot(normals[k], LIGHT))}%)`;
          pen.fill();
        }
        pen.stroke();
        if (solid) drawNumber(seen, face, normals[k], String(data.labels[k]));
      });
    }

    function drawNumber(seen, face, normal, text) {
      const centre = mean(face), up = unit(difference(mean([face[0], face[1]]), centre)), right = cross(up, normal);
      const inner = Math.min(...face.map((corner, k) => {
        const next = face[(k + 1) % face.length], along = unit(difference(next, corner));
        const from = difference(centre, corner);
        return Math.hypot(...difference(from, scaled(along, dot(from, along))));
      }));
      const letter = 1.1 * inner, [x, y] = seen.on(centre);
      const [rx, ry] = seen.on(sum(centre, scaled(right, letter))), [ux, uy] = seen.on(sum(centre, scaled(up, letter)));
      pen.save();
      // An affine picture of the face's plane, in which a letter is 100 units high.
      pen.transform((rx - x) / 100, (ry - y) / 100, (x - ux) / 100, (y - uy) / 100, x, y);
      pen.font = "600 100px system-ui, sans-serif";
      pen.textAlign = "center";
      pen.textBaseline = "middle";
      pen.fillStyle = "#1d2126";
      pen.fillText(text, 0, 0);
      pen.restore();
    }

    // --- the outline on the picture ---

    const picture = place.querySelector("svg image");
    const outlines = picture === null ? [] : motions.map((motion) => {
      const path = document.createElementNS("http://www.w3.org/2000/svg", "path");
      path.setAttribute("stroke", motion.colour);
      path.setAttribute("stroke-width", motion === motions[0] ? MEASURED_WIDTH : MODEL_WIDTH);
      path.setAttribute("vector-effect", "non-scaling-stroke");
      path.setAttribute("stroke-linejoin", "round");
      if (motion === motions[0]) path.setAttribute("fill", "rgba(255, 255, 255, 0.35)");
      const [x, y, width, height] = ["x", "y", "width", "height"].map((name) => picture[name].baseVal.value);
      const across = width / data.picture_px[0], down = height / data.picture_px[1];
      // The centre of the first pixel is at 0.
      path.setAttribute("transform", `translate(${x + 0.5 * across} ${y + 0.5 * down}) scale(${across} ${down})`);
      path.dataset.motion = motion.name;
      picture.parentNode.append(path);
      return path;
    });

    function outline(motion) {
      if (!motion.shown || motion.corners === null) return "";
      const count = data.vertices.length, begin = 2 * count * row;
      const at = (corner) => [0, 1].map((axis) => motion.corners[begin + 2 * corner + axis]);
      return data.faces.map((face) => {
        const points = face.map(at);
        if (points.some(([x]) => x === UNKNOWN)) return "";
        const places = points.map(([x, y]) => [x / CORNER_UNITS, y / CORNER_UNITS]);
        // Faces are counter-clockwise seen from outside, and the picture's y points down.
        const area = places.reduce((total, [x, y], k) => {
          const [nx, ny] = places[(k + 1) % places.length];
          return total + x * ny - nx * y;
        }, 0);
        return area < 0 ? `M${places.map(([x, y]) => `${x} ${y}`).join("L")}z` : "";
      }).join("");
    }

    // --- time ---

    function sentence() {
      const passed = data.impacts.filter((impact) => impact.time_ms <= times[row]).length;
      const words = [`frame ${frames[row]}`, `${times[row].toFixed(1)} ms`];
      words.push(passed ? `after bounce ${passed}` : "before the first bounce");
      if (!isKnown(motions[0], row)) words.push(`no ${motions[0].name} pose`);
      return words.join(", ");
    }

    function show() {
      place.dataset.frame = frames[row];
      slider.value = row;
      now.textContent = sentence();
      slider.setAttribute("aria-valuetext", now.textContent);
      outlines.forEach((path, k) => path.setAttribute("d", outline(motions[k])));
      draw();
    }

    function go(to) {
      row = Math.max(0, Math.min(last, to));
      show();
    }

    function stop() {
      started = null;
      button.textContent = "▶ Play";
      button.setAttribute("aria-pressed", "false");
    }

    function start() {
      if (row === last) row = 0;
      started = { at: performance.now(), time_ms: times[row] };
      button.textContent = "❚❚ Pause";
      button.setAttribute("aria-pressed", "true");
      requestAnimationFrame(advance);
    }

    function advance(at) {
      if (started === null) return;
      const time_ms = started.time_ms + (at - started.at) / Number(speed.value);
      let to = row;
      while (to < last && times[to + 1] <= time_ms) to += 1;
      if (to !== row) go(to);
      if (to === last) stop();
      else requestAnimationFrame(advance);
    }

    // --- what the reader does ---

    const toggle = () => (started === null ? start() : stop());
    button.addEventListener("click", toggle);
    slider.max = last;
    slider.addEventListener("input", () => {
      stop();
      go(Number(slider.value));
    });
    speed.addEventListener("change", () => {
      if (started !== null) started = { at: performance.now(), time_ms: times[row] };
    });
    part("follow").addEventListener("change", (event) => {
      view.follow = event.target.checked;
      draw();
    });
    for (const box of place.querySelectorAll("[data-motion]"))
      if (box.matches("input"))
        box.addEventListener("change", () => {
          motions.find((motion) => motion.name === box.dataset.motion).shown = box.checked;
          show();
        });
    function turn(azimuth, elevation) {
      view.azimuth += azimuth;
      view.elevation = Math.max(LOWEST, Math.min(STEEPEST, view.elevation + elevation));
      draw();
    }
    canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
    canvas.addEventListener("pointermove", (event) => {
      if (canvas.hasPointerCapture(event.pointerId)) turn(-TURN * event.movementX, TURN * event.movementY);
    });
    const keys = {
      ArrowLeft: () => turn(-KEY_TURN, 0),
      ArrowRight: () => turn(KEY_TURN, 0),
      ArrowUp: () => turn(0, KEY_TURN),
      ArrowDown: () => turn(0, -KEY_TURN),
      "+": () => ((view.zoom *= ZOOM), draw()),
      "-": () => ((view.zoom /= ZOOM), draw()),
      " ": toggle,
    };
    canvas.addEventListener("keydown", (event) => {
      if (!(event.key in keys) || event.ctrlKey || event.metaKey || event.altKey) return;
      event.preventDefault();
      keys[event.key]();
    });
    new ResizeObserver(draw).observe(canvas);
    window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
    window.addEventListener("beforeprint", draw);
    show();
  }
})();
