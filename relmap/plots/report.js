"use strict";
(() => {
  const WALL = "#1f4e9e", CORNER = "#0b7a3b", DOT = "#222", PATH = "#e08a1e", FAINT = "#c9ced6";
  const POINT = "#a5abb3", LATER = "#e3e5e8", WEAK = "#c0392b", ROBOT = "#c0392b", GRID = "#eef0f2";
  const SECONDS = 20;  // that a replay takes
  const NEAR = 12;  // pixels from the pointer at which something is named
  const element = (id) => document.getElementById(id);
  const unpack = (text, kind) => {
    if (!text) return new kind(0);
    const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
    return new kind(bytes.buffer);
  };
  const kinds = {
    lines: Float32Array, lineNames: Int32Array, lineSeen: Int32Array, lineFirst: Int32Array,
    dots: Float32Array, dotNames: BigInt64Array, dotSeen: Int32Array, dotFirst: Int32Array,
    path: Float32Array, yaw: Float32Array, iterations: Int32Array, stamps: Float64Array,
    points: Uint16Array, pointFrom: Int32Array,
  };
  const views = JSON.parse(element("data").textContent).map((packed) => {
    const view = Object.assign({weak: [], leaps: [], rings: []}, packed);
    for (const name in kinds) view[name] = unpack(packed[name], kinds[name]);
    view.rings = view.rings.map((ring) => ({name: ring.name, at: unpack(ring.at, Float32Array)}));
    view.n = view.yaw.length;
    return view;
  });

  const canvas = element("map"), context = canvas.getContext("2d");
  const slider = element("time"), play = element("play");
  let view = views[0], up = 1, centre = [0, 0], scale = 1, now = 0, playing = 0, waiting = false;

  // Places have axes 0 and `up`; on the screen the second one points upwards.
  const screen = (x, y) => [
    canvas.clientWidth / 2 + (x - centre[0]) * scale, canvas.clientHeight / 2 - (y - centre[1]) * scale,
  ];
  const world = (px, py) => [
    centre[0] + (px - canvas.clientWidth / 2) / scale, centre[1] - (py - canvas.clientHeight / 2) / scale,
  ];
  const place = (array, k) => screen(array[k * view.axes], array[k * view.axes + up]);

  function whole() {
    const [low, high] = view.limits;
    centre = [(low[0] + high[0]) / 2, (low[up] + high[up]) / 2];
    const wide = Math.max(high[0] - low[0], 1e-3), tall = Math.max(high[up] - low[up], 1e-3);
    scale = 0.92 * Math.min(canvas.clientWidth / wide, canvas.clientHeight / tall);
    ask();
  }

  function zoom(factor, px = canvas.clientWidth / 2, py = canvas.clientHeight / 2) {
    const [x, y] = world(px, py);
    scale = Math.min(Math.max(scale * factor, 1e-6), 1e6);
    const [there, that] = world(px, py);
    centre = [centre[0] + x - there, centre[1] + y - that];
    ask();
  }

  function ask() {
    if (!waiting) requestAnimationFrame(() => { waiting = false; draw(); });
    waiting = true;
  }

  const round = (length) => {  // the next of 1, 2, 5, 10, ... that is not longer
    const ten = 10 ** Math.floor(Math.log10(length));
    return [5, 2, 1].find((k) => k * ten <= length * (1 + 1e-9)) * ten;
  };

  function draw() {
    const ratio = window.devicePixelRatio || 1;
    canvas.width = Math.round(canvas.clientWidth * ratio);
    canvas.height = Math.round(canvas.clientHeight * ratio);
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    drawGrid();
    drawPoints();
    drawPath();
    drawLines();
    drawDots();
    drawWeak();
    drawRobot();
    showTime();
  }

  function drawGrid() {
    const step = round(120 / scale), [left, top] = world(0, 0);
    const [right, bottom] = world(canvas.clientWidth, canvas.clientHeight);
    context.strokeStyle = GRID;
    context.lineWidth = 1;
    context.beginPath();
    for (let x = Math.ceil(left / step) * step; x < right; x += step) {
      const [px] = screen(x, 0);
      context.moveTo(px, 0);
      context.lineTo(px, canvas.clientHeight);
    }
    for (let y = Math.ceil(bottom / step) * step; y < top; y += step) {
      const [, py] = screen(0, y);
      context.moveTo(0, py);
      context.lineTo(canvas.clientWidth, py);
    }
    context.stroke();
    element("scale").style.width = `${step * scale}px`;
    element("scale").textContent = `${Number(step.toPrecision(1))} m`;
  }

  function drawPoints() {
    if (!view.pointFrom.length) return;
    const [low, step, end] = [view.pointLow, view.pointStep, view.points.length / 2];
    const seen = now + 1 < view.pointFrom.length ? view.pointFrom[now + 1] : end;
    for (const [from, to, colour] of [[seen, end, LATER], [0, seen, POINT]]) {
      context.fillStyle = colour;
      for (let k = from; k < to; k++) {
        const x = low[0] + view.points[2 * k] * step[0], y = low[1] + view.points[2 * k + 1] * step[1];
        const [px, py] = screen(x, y);
        context.fillRect(px, py, 1.1, 1.1);
      }
    }
  }

  function trace(from, to) {
    context.beginPath();
    for (let k = from; k <= to; k++) {
      const [px, py] = place(view.path, k);
      if (k === from || leaps.has(k)) context.moveTo(px, py);
      else context.lineTo(px, py);
    }
    context.stroke();
  }

  function drawPath() {
    if (!view.n) return;
    context.lineWidth = 1;
    context.strokeStyle = FAINT;
    trace(now, view.n - 1);
    context.strokeStyle = PATH;
    trace(0, now);
    mark(0, (px, py) => context.arc(px, py, 4, 0, 7));
    mark(view.n - 1, (px, py) => context.rect(px - 3.5, py - 3.5, 7, 7));
  }

  function mark(k, shape) {
    context.fillStyle = "#333";
    context.beginPath();
    shape(...place(view.path, k));
    context.fill();
  }

  function drawLines() {
    const n = view.lines.length / (2 * view.axes);
    for (const later of [true, false]) {
      context.strokeStyle = later ? FAINT : WALL;
      context.lineWidth = later ? 1 : 1.8;
      context.beginPath();
      for (let k = 0; k < n; k++) {
        if (view.lineFirst[k] > now !== later) continue;
        context.moveTo(...place(view.lines, 2 * k));
        context.lineTo(...place(view.lines, 2 * k + 1));
      }
      context.stroke();
    }
  }

  function drawDots() {
    const n = view.dots.length / view.axes, walls = view.lines.length > 0;
    const size = walls ? 1.2 : Math.min(Math.max(60 / Math.sqrt(n + 1), 1.5), 3.5);
    for (let k = 0; k < n; k++) {
      const [px, py] = place(view.dots, k);
      context.fillStyle = view.dotFirst.length && view.dotFirst[k] > now ? FAINT : walls ? CORNER : DOT;
      context.beginPath();
      context.arc(px, py, size, 0, 7);
      context.fill();
    }
  }

  function drawWeak() {
    context.strokeStyle = WEAK;
    context.lineWidth = 1.5;
    const ring = (px, py) => {
      context.beginPath();
      context.arc(px, py, 7, 0, 7);
      context.stroke();
    };
    for (const k of view.weak) {
      const [a, b] = [place(view.path, k - 1), place(view.path, k)];
      ring((a[0] + b[0]) / 2, (a[1] + b[1]) / 2);
    }
    for (const {at} of view.rings) {
      for (let k = 0; k < at.length / view.axes; k++) ring(...place(at, k));
    }
  }

  function drawRobot() {
    if (!view.n) return;
    const [px, py] = place(view.path, now), yaw = up === 1 ? view.yaw[now] : 0;
    context.fillStyle = ROBOT;
    context.beginPath();
    for (const [ahead, left] of [[11, 0], [-6, 6], [-6, -6]]) {
      const x = ahead * Math.cos(yaw) - left * Math.sin(yaw);
      const y = ahead * Math.sin(yaw) + left * Math.cos(yaw);
      context.lineTo(px + x, py - y);
    }
    context.fill();
  }

  function showTime() {
    if (!view.n) {
      element("now").textContent = view.caption;
      return;
    }
    const stamp = view.stamps.length ? `, ${(view.stamps[now] - view.stamps[0]).toFixed(1)} s` : "";
    const at = Array.from(view.path.subarray(now * view.axes, (now + 1) * view.axes));
    element("now").textContent =
      `iteration ${view.iterations[now]}${stamp}, robot at ${at.map((v) => v.toFixed(2)).join(", ")} m ` +
      `(pose ${now + 1} of ${view.n}); ${view.caption}`;
  }

  let leaps = new Set();
  function show(k) {
    view = views[k];
    leaps = new Set(view.leaps);
    up = 1;
    now = Math.max(view.n - 1, 0);
    slider.max = String(now);
    slider.value = String(now);
    element("replay").hidden = view.n < 2;
    element("side").hidden = view.axes < 3;
    element("side").textContent = "from the side";
    links();
    legend();
    whole();
  }

  function links() {
    const list = element("links");
    if (!list) return;
    list.textContent = view.weak.length ? "" : `none in this ${view.name === "map" ? "map" : "submap"}`;
    for (const k of view.weak) {
      const button = document.createElement("button");
      button.type = "button";
      button.textContent = String(view.iterations[k]);
      button.addEventListener("click", () => {
        goto(k);
        canvas.scrollIntoView({block: "center"});
      });
      list.append(button, " ");
    }
  }

  function legend() {
    const walls = [[WALL, "wall"], [CORNER, "corner"]], edges = [[WALL, "edge of a plane"]];
    const shown = !view.lines.length ? [[DOT, "landmark"]] : view.axes === 2 ? walls : edges;
    if (view.points.length) shown.push([POINT, "points of the scans"]);
    if (view.n) shown.push([PATH, "path"], ["#333", "start (round), end (square)"], [ROBOT, "robot"]);
    if (view.weak.length) shown.push([WEAK, "weak link"]);
    if (view.rings.length) shown.push([WEAK, view.rings.map((ring) => ring.name).join(", ")]);
    if (view.n) shown.push([FAINT, "later"]);
    const list = element("legend");
    list.textContent = "";
    for (const [colour, name] of shown) {
      const patch = document.createElement("i");
      patch.style.background = colour;
      list.append(patch, name);
    }
  }

  function goto(k) {
    now = Math.min(Math.max(k, 0), Math.max(view.n - 1, 0));
    slider.value = String(now);
    ask();
  }

  function stop() {
    playing = 0;
    play.textContent = "play";
  }

  play.addEventListener("click", () => {
    if (playing) return stop();
    const from = now < view.n - 1 ? now : 0, began = performance.now(), own = ++playing;
    play.textContent = "stop";
    const step = (time) => {
      if (playing !== own) return;
      goto(from + Math.floor((time - began) / 1000 * view.n / SECONDS));
      if (now < view.n - 1) requestAnimationFrame(step);
      else stop();
    };
    requestAnimationFrame(step);
  });
  slider.addEventListener("input", () => { stop(); goto(Number(slider.value)); });
  element("in").addEventListener("click", () => zoom(1.5));
  element("out").addEventListener("click", () => zoom(1 / 1.5));
  element("whole").addEventListener("click", whole);
  element("side").addEventListener("click", () => {
    up = 3 - up;
    element("side").textContent = up === 1 ? "from the side" : "from above";
    whole();
  });

  // What lies under the pointer, by its number.
  function name(px, py) {
    const [x, y] = world(px, py), words = [];
    let best = NEAR;
    for (let k = 0; k < view.lines.length / (2 * view.axes); k++) {
      const [[x0, y0], [x1, y1]] = [2 * k, 2 * k + 1].map((end) => world(...place(view.lines, end)));
      const dx = x1 - x0, dy = y1 - y0, long = Math.hypot(dx, dy);
      const t = Math.min(Math.max(((x - x0) * dx + (y - y0) * dy) / (long * long || 1), 0), 1);
      const off = Math.hypot(x - x0 - t * dx, y - y0 - t * dy) * scale;
      if (off >= best) continue;
      best = off;
      const kind = view.axes === 2 ? "wall" : "plane";
      const size = view.axes === 2 ? `: ${long.toFixed(2)} m` : "";
      words[0] = `${kind} ${view.lineNames[k]}${size}, seen ${view.lineSeen[k]} times`;
    }
    for (let k = 0; k < view.dotNames.length; k++) {
      const [qx, qy] = place(view.dots, k), off = Math.hypot(px - qx, py - qy);
      if (off >= best) continue;
      best = off;
      words[0] = `landmark ${view.dotNames[k]}`;
      if (view.dotSeen.length) words[0] += `, seen ${view.dotSeen[k]} times`;
    }
    words.unshift(`x ${x.toFixed(2)}, ${"xyz"[up]} ${y.toFixed(2)} m`);
    element("under").textContent = words.join("; ");
  }

  const fingers = new Map();
  const here = (event) => {
    const box = canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  };
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, here(event));
  });
  for (const over of ["pointerup", "pointercancel"]) {
    canvas.addEventListener(over, (event) => fingers.delete(event.pointerId));
  }
  canvas.addEventListener("pointermove", (event) => {
    const to = here(event), from = fingers.get(event.pointerId);
    name(...to);
    if (!from) return;
    const other = [...fingers].find(([id]) => id !== event.pointerId);
    fingers.set(event.pointerId, to);
    if (other) {  // two fingers: what was between them stays there
      const [ox, oy] = other[1];
      zoom(Math.hypot(to[0] - ox, to[1] - oy) / (Math.hypot(from[0] - ox, from[1] - oy) || 1), ox, oy);
      return;
    }
    centre = [centre[0] - (to[0] - from[0]) / scale, centre[1] + (to[1] - from[1]) / scale];
    ask();
  });
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoom(Math.exp(-event.deltaY * (event.deltaMode ? 0.05 : 0.0015)), ...here(event));
  }, {passive: false});
  canvas.addEventListener("keydown", (event) => {
    const step = 40 / scale;
    const moves = {ArrowLeft: [-step, 0], ArrowRight: [step, 0], ArrowUp: [0, step], ArrowDown: [0, -step]};
    if (event.key === "+" || event.key === "=") zoom(1.25);
    else if (event.key === "-") zoom(0.8);
    else if (event.key === "0") whole();
    else if (moves[event.key]) centre = centre.map((v, k) => v + moves[event.key][k]);
    else return;
    event.preventDefault();
    ask();
  });
  new ResizeObserver(ask).observe(canvas);

  const select = element("view");
  views.forEach((each, k) => select.append(new Option(`${each.name}: ${each.caption}`, String(k))));
  select.hidden = views.length < 2;
  select.addEventListener("change", () => { stop(); show(Number(select.value)); });
  if (views.length) show(0);
})();
