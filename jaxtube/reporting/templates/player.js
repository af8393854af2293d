"use strict";
/* Plays laps that stand in this page.

   window.player, for those who script the page:
     state           { controller, lap, beside, step, playing, speed, view, scale }: what is shown;
                     step may lie between two instants while a lap plays
     controllers     names; laps(controller): numbers of the laps that are shown of it
     pose(c, l, k)   [x m, y m, heading rad] of lap l (its place) of controller c at instant k
     errors(c, l, k) [m, m, rad], NaN where the lap has no finite number
     set(changes)    changes the state and draws; play(), pause(), seek(step)                     */
(() => {
  const data = JSON.parse(document.getElementById("laps").textContent);
  const find = (id) => document.getElementById(id);
  const reduced = matchMedia("(prefers-reduced-motion: reduce)");
  const last = data.instants - 1;
  const MISSING = -32768;
  const LIVE_MS = 5000;

  // ---- numbers -------------------------------------------------------------------------------
  const bytes = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)).buffer;
  const reader = (packed, laps, channels) => {
    if (!packed) return null;
    const view = new DataView(bytes(packed.data));
    return (lap, instant, channel) => {
      const whole = view.getInt16(2 * ((instant * laps + lap) * channels + channel), true);
      return whole === MISSING ? NaN : whole * packed.step[channel];
    };
  };
  const path = new DataView(bytes(data.reference));
  const reference = (k, channel) => path.getFloat32(4 * (3 * k + channel), true);
  const sets = data.controllers.map((entry) => ({
    ...entry,
    error: reader(entry.errors, entry.numbers.length, 3),
    wheel: reader(entry.wheels, entry.numbers.length, 2),
  }));
  const mix = (read, k) => {
    const low = Math.min(Math.floor(k), last);
    const share = k - low;
    return share > 0 ? (1 - share) * read(low) + share * read(low + 1) : read(low);
  };
  const errorsAt = (c, l, k) => [0, 1, 2].map((i) => mix((n) => sets[c].error(l, n, i), k));
  const referenceAt = (k) => [0, 1, 2].map((i) => mix((n) => reference(n, i), k));
  const place = (errors, [x, y, heading]) => {
    const turned = heading - errors[2];
    const [c, s] = [Math.cos(turned), Math.sin(turned)];
    return [x - c * errors[0] + s * errors[1], y - s * errors[0] - c * errors[1], turned];
  };
  const poseAt = (c, l, k) => place(errorsAt(c, l, k), referenceAt(k));
  // The same lap of another controller: the one of the same draws, else its median one.
  const twin = (c) => {
    const number = sets[state.controller].numbers[state.lap];
    const same = sets[c].numbers.indexOf(number);
    return c === state.controller ? state.lap : same >= 0 ? same : sets[c].median;
  };
  const usageAt = (c, errors) => Math.max(...errors.map((e, i) => Math.abs(e) / sets[c].limits[i]));

  // What all laps of a controller span at every instant, for the bands.
  const spans = sets.map((set) => [0, 1, 2].map((i) => {
    const low = new Float32Array(data.instants).fill(Infinity);
    const high = new Float32Array(data.instants).fill(-Infinity);
    for (let k = 0; k <= last; k++) {
      for (let l = 0; l < set.numbers.length; l++) {
        const value = set.error(l, k, i);
        if (value < low[k]) low[k] = value;
        if (value > high[k]) high[k] = value;
      }
    }
    return { low, high };
  }));
  const bounds = (() => {
    const box = [Infinity, Infinity, -Infinity, -Infinity];
    for (let k = 0; k <= last; k++) {
      const [x, y] = [reference(k, 0), reference(k, 1)];
      box[0] = Math.min(box[0], x); box[1] = Math.min(box[1], y);
      box[2] = Math.max(box[2], x); box[3] = Math.max(box[3], y);
    }
    return box;
  })();

  // ---- state ---------------------------------------------------------------------------------
  const first = sets.length - 1; // the last one is drawn over all others: the tube-MPC
  const state = { controller: first, lap: sets[first].median, beside: -1, step: 0,
    playing: false, speed: 1, view: "near", scale: "limits" };
  const colours = {};
  const readColours = () => {
    const style = getComputedStyle(document.documentElement);
    for (const name of ["ink", "soft", "rule", "raised", "paper", "bad"]) {
      colours[name] = style.getPropertyValue(`--${name}`).trim();
    }
  };

  // Colours of a white page are too dark on a dark one.
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const tint = (colour) => {
    if (!dark.matches || matchMedia("print").matches) return colour;
    const parts = [1, 3, 5].map((n) => parseInt(colour.slice(n, n + 2), 16));
    return `rgb(${parts.map((part) => Math.round(part + 0.38 * (255 - part))).join(",")})`;
  };

  // ---- drawing -------------------------------------------------------------------------------
  const prepare = (canvas) => {
    const ratio = window.devicePixelRatio || 1;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
    }
    const pen = canvas.getContext("2d");
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, width, height);
    pen.font = "12px system-ui, sans-serif";
    return { pen, width, height };
  };
  const line = (pen, points, colour, width, dashes = []) => {
    pen.beginPath();
    let open = false;
    for (const [x, y] of points) {
      if (!Number.isFinite(x) || !Number.isFinite(y)) { open = false; continue; }
      if (open) pen.lineTo(x, y); else pen.moveTo(x, y);
      open = true;
    }
    pen.strokeStyle = colour;
    pen.lineWidth = width;
    pen.setLineDash(dashes);
    pen.stroke();
    pen.setLineDash([]);
  };
  const polygon = (pen, points, { fill, stroke, width = 1, dashes = [], alpha = 1 }) => {
    pen.beginPath();
    points.forEach(([x, y], n) => (n ? pen.lineTo(x, y) : pen.moveTo(x, y)));
    pen.closePath();
    pen.globalAlpha = alpha;
    if (fill) { pen.fillStyle = fill; pen.fill(); }
    pen.globalAlpha = 1;
    if (stroke) {
      pen.strokeStyle = stroke; pen.lineWidth = width; pen.setLineDash(dashes);
      pen.stroke(); pen.setLineDash([]);
    }
  };
  const frame = (view, [x, y, heading]) => {
    const [c, s] = [Math.cos(heading), Math.sin(heading)];
    return ([along, aside]) => view(x + c * along - s * aside, y + s * along + c * aside);
  };

  // Track to scale; the lengths of body and wheels are none that a scenario knows.
  const robot = (pen, view, pose, colour, outlined) => {
    if (!pose.every(Number.isFinite)) return;
    const half = data.track_m / 2;
    const to = frame(view, pose);
    const isClose = state.view === "close"; // inside the robot, whose body would fill the view
    const look = outlined || isClose
      ? { stroke: colour, width: 1.2, dashes: [4, 3] }
      : { fill: colour, alpha: 0.16, stroke: colour, width: 1.6 };
    const length = 0.75 * data.track_m;
    const body = [[-length / 2, -0.78 * half], [length / 2, -0.78 * half], [0.72 * length, 0],
      [length / 2, 0.78 * half], [-length / 2, 0.78 * half]];
    polygon(pen, body.map(to), look);
    for (const side of [-half, half]) {
      const [long, wide] = [0.24 * data.track_m, 0.06 * data.track_m];
      const wheel = [[-long, side - wide], [long, side - wide], [long, side + wide], [-long, side + wide]];
      polygon(pen, wheel.map(to), outlined ? look : { fill: colour });
    }
    const [x, y] = to([0, 0]);
    pen.beginPath();
    pen.arc(x, y, 4, 0, 2 * Math.PI);
    if (outlined) { pen.strokeStyle = colour; pen.lineWidth = 1.5; pen.stroke(); }
    else { pen.fillStyle = colour; pen.fill(); }
  };

  const fit = (box, width, height, margin) => {
    const spanX = Math.max(box[2] - box[0], 1e-9);
    const spanY = Math.max(box[3] - box[1], 1e-9);
    const scale = Math.min((width - 2 * margin) / spanX, (height - 2 * margin) / spanY);
    const [midX, midY] = [(box[0] + box[2]) / 2, (box[1] + box[3]) / 2];
    const view = (x, y) => [width / 2 + scale * (x - midX), height / 2 - scale * (y - midY)];
    return Object.assign(view, { scale });
  };
  const referencePath = (view) => Array.from({ length: data.instants }, (_, k) =>
    view(reference(k, 0), reference(k, 1)));
  const driven = (view, c, l, from) => {
    const points = [];
    for (let k = Math.max(0, Math.floor(from)); k <= state.step; k++) {
      points.push(view(...poseAt(c, l, k)));
    }
    points.push(view(...poseAt(c, l, state.step)));
    return points;
  };
  const niceLength = (most) => {
    const power = 10 ** Math.floor(Math.log10(most));
    return power * ([5, 2, 1].find((n) => n * power <= most) || 1);
  };
  const drawScale = (pen, view, width, height) => {
    const length = niceLength(width / 4 / view.scale);
    const [x, y] = [width - 12, height - 14];
    line(pen, [[x - length * view.scale, y], [x, y]], colours.ink, 2);
    pen.fillStyle = colours.ink;
    pen.textAlign = "right";
    pen.fillText(length < 1 ? `${+(100 * length).toPrecision(2)} cm` : `${length} m`, x, y - 6);
    pen.textAlign = "left";
  };

  // Room for the section of the tube and for all laps now.
  const closeReach = () => {
    const points = sets[state.controller].section.map(([x, y]) => Math.hypot(x, y));
    for (let l = 0; l < sets[state.controller].numbers.length; l++) {
      const [x, y] = errorsAt(state.controller, l, state.step);
      points.push(Math.hypot(x, y));
    }
    return 1.25 * Math.max(1e-3, ...points.filter(Number.isFinite));
  };

  const drawField = () => {
    const { pen, width, height } = prepare(find("field"));
    const set = sets[state.controller];
    const at = referenceAt(state.step);
    const reach = state.view === "close" ? closeReach()
      : Math.max(2.1 * Math.max(set.limits[0], set.limits[1]), 1.6 * data.track_m);
    const near = [at[0] - reach, at[1] - reach, at[0] + reach, at[1] + reach];
    const isNear = state.view !== "whole";
    const view = fit(isNear ? near : bounds, width, height, isNear ? 0 : 34);
    const mine = poseAt(state.controller, state.lap, state.step);
    const tail = isNear ? state.step - 4 / data.period_s : 0;
    line(pen, referencePath(view), colours.soft, 1.2, [2, 3]);
    if (mine.every(Number.isFinite)) {
      // Where the reference may be, seen from the robot: e in E, and e in the tube's section.
      const around = frame(view, [at[0], at[1], mine[2]]);
      const [a, b] = set.limits;
      polygon(pen, [[-a, -b], [a, -b], [a, b], [-a, b]].map(around),
        { stroke: colours.ink, width: 1.3, dashes: [6, 4] });
      polygon(pen, set.section.map(([x, y]) => around([-x, -y])),
        { fill: "#e69f00", alpha: 0.4, stroke: "#e69f00" });
    }
    robot(pen, view, at, colours.soft, true);
    const colour = tint(set.colour);
    pen.globalAlpha = 0.5;
    for (let l = 0; l < set.numbers.length; l++) {
      if (l === state.lap) continue;
      const [x, y] = view(...poseAt(state.controller, l, state.step));
      pen.fillStyle = colour;
      pen.beginPath();
      pen.arc(x, y, 2.2, 0, 2 * Math.PI);
      pen.fill();
    }
    pen.globalAlpha = 1;
    if (state.beside >= 0) {
      const l = twin(state.beside);
      const other = tint(sets[state.beside].colour);
      line(pen, driven(view, state.beside, l, tail), other, 1.6);
      robot(pen, view, poseAt(state.beside, l, state.step), other, false);
    }
    line(pen, driven(view, state.controller, state.lap, tail), colour, 2);
    robot(pen, view, mine, colour, false);
    drawScale(pen, view, width, height);
    if (isNear) drawOverview(pen, mine, colour, height);
  };

  const drawOverview = (pen, mine, colour, height) => {
    const [side, gap] = [Math.min(130, height / 3), 10];
    const inner = fit(bounds, side, side, 12);
    const view = (x, y) => { const [u, v] = inner(x, y); return [u + gap, v + height - side - gap]; };
    polygon(pen, [[gap, height - side - gap], [gap + side, height - side - gap],
      [gap + side, height - gap], [gap, height - gap]],
      { fill: colours.paper, alpha: 0.85, stroke: colours.rule });
    line(pen, referencePath(view), colours.soft, 1);
    const [x, y] = view(mine[0], mine[1]);
    pen.fillStyle = colour;
    pen.beginPath();
    pen.arc(x, y, 3.5, 0, 2 * Math.PI);
    pen.fill();
  };

  const EDGE = { left: 58, right: 10, top: 12, bottom: 26, gap: 20 };
  const drawPlots = () => {
    const { pen, width, height } = prepare(find("plots"));
    const tall = (height - EDGE.top - EDGE.bottom - 2 * EDGE.gap) / 3;
    const x = (k) => EDGE.left + (width - EDGE.left - EDGE.right) * k / Math.max(last, 1);
    for (let i = 0; i < 3; i++) {
      drawErrors(pen, i, x, EDGE.top + i * (tall + EDGE.gap), tall, width);
    }
    const [top, bottom] = [EDGE.top, height - EDGE.bottom];
    line(pen, [[x(state.step), top], [x(state.step), bottom]], colours.ink, 1.2);
    pen.fillStyle = colours.soft;
    pen.textAlign = "center";
    const end = last * data.period_s;
    const tick = niceLength(end / 3);
    for (let t = 0; t <= end * 1.0001; t += tick) {
      pen.fillText(+t.toPrecision(4), Math.min(x(t / data.period_s), width - 18), height - 10);
    }
    pen.textAlign = "left";
    pen.fillText("s", width - 9, height - 10);
  };
  const drawErrors = (pen, i, x, top, tall, width) => {
    const { to, symbol, unit } = data.coordinates[i];
    const shown = [state.controller, ...(state.beside >= 0 ? [state.beside] : [])];
    const limit = sets[state.controller].limits[i];
    let reach = 1.12 * limit;
    const largest = Math.max(...shown.flatMap((c) => [...spans[c][i].high, ...spans[c][i].low])
      .filter(Number.isFinite).map(Math.abs));
    if (state.scale === "data") reach = 1.08 * largest || reach;
    else reach = Math.max(reach, Math.min(1.05 * largest, 2.5 * limit));
    const y = (value) => top + tall / 2 - (value / reach) * tall / 2;
    pen.save();
    pen.beginPath();
    pen.rect(EDGE.left, top, width - EDGE.left - EDGE.right, tall);
    pen.clip();
    line(pen, [[EDGE.left, y(0)], [width, y(0)]], colours.rule, 1);
    for (const side of [-limit, limit]) {
      line(pen, [[EDGE.left, y(side)], [width, y(side)]], colours.ink, 1.2, [6, 4]);
    }
    for (const c of [...shown].reverse()) {
      const { low, high } = spans[c][i];
      const upper = Array.from(high, (value, k) => [x(k), y(value)]);
      const lower = Array.from(low, (value, k) => [x(k), y(value)]).reverse();
      const band = [...upper, ...lower].filter(([, value]) => Number.isFinite(value));
      if (band.length) polygon(pen, band, { fill: tint(sets[c].colour), alpha: 0.25 });
      const points = Array.from({ length: data.instants }, (_, k) => [x(k), y(sets[c].error(twin(c), k, i))]);
      line(pen, points, tint(sets[c].colour), c === state.controller ? 1.8 : 1.2);
    }
    pen.restore();
    line(pen, [[EDGE.left, top], [EDGE.left, top + tall]], colours.soft, 1);
    pen.fillStyle = colours.ink;
    pen.fillText(symbol, 6, top + tall / 2 - 2);
    pen.fillStyle = colours.soft;
    pen.fillText(unit, 6, top + tall / 2 + 13);
    pen.textAlign = "right";
    // The limits at their lines; the ends of the axis only where they are well beyond.
    const told = y(limit) - top > 14 ? [reach, limit] : [limit];
    for (const value of told.filter((one) => one <= reach)) {
      const text = +(to * value).toPrecision(3);
      pen.fillText(text, EDGE.left - 5, Math.max(y(value) + 4, top + 9));
      pen.fillText(`−${text}`, EDGE.left - 5, Math.min(y(-value) + 4, top + tall));
    }
    pen.textAlign = "left";
  };

  // ---- words ---------------------------------------------------------------------------------
  const signed = (value) => `${+value.toPrecision(3)}`.replace("-", "−");
  const seconds = (k) => (k * data.period_s).toFixed(2);
  const say = (c, l, k) => {
    const errors = errorsAt(c, l, k);
    if (!errors.every(Number.isFinite)) return "no finite error";
    const parts = errors.map((value, i) => {
      const { symbol, to, unit } = data.coordinates[i];
      const used = (100 * Math.abs(value) / sets[c].limits[i]).toFixed(0);
      return `${symbol} ${signed(to * value)} ${unit} (${used} % of ±${+(to * sets[c].limits[i]).toPrecision(3)})`;
    });
    const beyond = usageAt(c, errors) > 1 ? "; outside E" : "";
    return `${parts.join(", ")}${beyond}`;
  };
  const describe = () => {
    const set = sets[state.controller];
    const k = Math.round(state.step);
    const wheels = set.wheel && k < last
      ? `; wheels ${[1, 0].map((i) => set.wheel(state.lap, k, i).toFixed(2)).join(" and ")} m/s (left, right)` : "";
    const other = state.beside >= 0
      ? ` ${sets[state.beside].label}, lap ${sets[state.beside].numbers[twin(state.beside)]}: `
        + `${say(state.beside, twin(state.beside), k)}.` : "";
    return `${set.label}, lap ${set.numbers[state.lap]}, at ${seconds(k)} s: `
      + `${say(state.controller, state.lap, k)}${wheels}.${other}`;
  };
  let told = 0;
  let pending = 0;
  const tell = (now) => {
    clearTimeout(pending);
    const speak = () => { told = performance.now(); find("status").textContent = describe(); };
    if (now) speak();
    else if (state.playing) { if (performance.now() - told > LIVE_MS) speak(); }
    else pending = setTimeout(speak, 250);
  };

  const draw = (speaksNow = false) => {
    drawField();
    drawPlots();
    find("time").value = Math.round(state.step);
    find("time").setAttribute("aria-valuetext", `${seconds(state.step)} s of ${seconds(last)} s`);
    find("clock").textContent = `${seconds(state.step)} of ${seconds(last)} s`;
    find("play").textContent = state.playing ? "Pause" : "Play";
    tell(speaksNow);
  };

  // ---- controls ------------------------------------------------------------------------------
  const option = (text, value) => Object.assign(document.createElement("option"), { textContent: text, value });
  const fillLaps = () => {
    const set = sets[state.controller];
    const of = set.kept < set.total ? " of those kept" : "";
    const outside = new Set(set.outside);
    const special = [option(`median${of} (${set.numbers[set.median]})`, set.median),
      option(`worst${of} (${set.numbers[set.worst]})`, set.worst)];
    const others = set.numbers.map((number, l) =>
      option(`${number}${outside.has(l) ? ", leaves E" : ""}`, `${l}`));
    const group = Object.assign(document.createElement("optgroup"), { label: "by number" });
    group.append(...others);
    find("lap").replaceChildren(...special, group);
    find("lap").value = `${state.lap}`;
    const count = set.outside.length;
    find("shown").textContent = `${set.numbers.length} of ${set.total.toLocaleString("en")} laps of this controller are in this page: `
      + `the worst and the median${of} by the largest share of a limit, and others from the first on; `
      + `${count} of these leave E. The dots and the bands are all of them. The tube holds errors around a plan: its last section is `
      + "drawn around the reference to show how wide it is.";
  };
  const fillBeside = () => {
    find("beside").replaceChildren(option("nothing", -1),
      ...sets.map((set, c) => option(set.label, c)).filter((_, c) => c !== state.controller));
    find("beside").value = `${state.beside}`;
  };
  const fillLegend = () => {
    const colour = tint(sets[state.controller].colour);
    const draw = (inside) => `<svg viewBox="0 0 24 14" aria-hidden="true">${inside}</svg>`;
    const keys = [
      [draw(`<rect x="5" y="2" width="14" height="10" fill="${colour}"/>`), "robot, track to scale"],
      [draw('<rect x="5" y="2" width="14" height="10" fill="none" stroke="currentColor" stroke-dasharray="3 2"/>'), "reference"],
      [draw('<rect x="1" y="1" width="22" height="12" fill="none" stroke="currentColor" stroke-width="1.6" stroke-dasharray="5 3"/>'), "E: where the robot's centre may be"],
      [draw('<rect x="4" y="3" width="16" height="8" fill="#e69f00" fill-opacity=".45" stroke="#e69f00"/>'), "last section of the tube"],
      [draw(`<circle cx="7" cy="7" r="2.4" fill="${colour}"/><circle cx="16" cy="5" r="2.4" fill="${colour}"/>`), "the other laps now"],
    ];
    find("legend").innerHTML = keys.map(([picture, words]) => `<li>${picture}${words}</li>`).join("");
  };
  const set = (changes) => {
    const before = { ...state };
    Object.assign(state, changes);
    state.step = Math.min(Math.max(state.step, 0), last);
    if (state.controller !== before.controller) {
      const kept = sets[state.controller];
      const same = kept.numbers.indexOf(sets[before.controller].numbers[before.lap]);
      if (!("lap" in changes)) state.lap = same >= 0 ? same : kept.median;
      if (state.beside === state.controller) state.beside = -1;
      fillLaps();
      fillBeside();
      fillLegend();
    }
    for (const name of ["controller", "lap", "beside", "view", "scale", "speed"]) {
      find(name).value = `${state[name]}`;
    }
    draw(!state.playing && !("step" in changes));
  };
  const seek = (step) => set({ step });
  const pause = () => { state.playing = false; state.step = Math.round(state.step); draw(true); };
  const play = () => {
    if (state.playing) return;
    if (state.step >= last) state.step = 0;
    state.playing = true;
    told = 0;
    draw();
    let before = null; // the clock of the pictures, which may lag behind the page's
    const go = (now) => {
      if (!state.playing) return;
      before ??= now;
      const steps = state.speed * (now - before) / 1000 / data.period_s;
      // Without motion: one jump a second instead of a picture that glides.
      if (!reduced.matches || now - before >= 1000) {
        before = now;
        state.step = Math.min(state.step + steps, last);
        if (reduced.matches) state.step = Math.round(state.step);
        draw();
      }
      if (state.step >= last) pause(); else requestAnimationFrame(go);
    };
    requestAnimationFrame(go);
  };
  const toggle = () => (state.playing ? pause() : play());

  const onKey = (event) => {
    const on = event.target;
    if (event.ctrlKey || event.altKey || event.metaKey) return;
    if (on.tagName === "SELECT" || (on.tagName === "BUTTON" && event.key === " ")) return;
    const jump = event.shiftKey ? Math.max(1, Math.round(1 / data.period_s)) : 1;
    const here = Math.round(state.step);
    const actions = { " ": toggle, ArrowLeft: () => seek(here - jump), ArrowRight: () => seek(here + jump),
      ArrowDown: () => seek(here - jump), ArrowUp: () => seek(here + jump),
      Home: () => seek(0), End: () => seek(last) };
    if (!(event.key in actions)) return;
    event.preventDefault();
    actions[event.key]();
  };
  const onDrag = (event) => {
    if (event.type === "pointermove" && !event.buttons) return;
    const canvas = find("plots");
    if (event.type === "pointerdown") canvas.setPointerCapture(event.pointerId);
    const width = canvas.clientWidth - EDGE.left - EDGE.right;
    seek(Math.round(last * (event.offsetX - EDGE.left) / width));
  };

  find("player").hidden = false;
  readColours();
  find("controller").append(...sets.map((entry, c) => option(entry.label, c)));
  find("time").max = last;
  fillLaps();
  fillBeside();
  fillLegend();
  for (const name of ["controller", "lap", "beside", "speed"]) {
    find(name).addEventListener("change", (event) => set({ [name]: +event.target.value }));
  }
  for (const name of ["view", "scale"]) {
    find(name).addEventListener("change", (event) => set({ [name]: event.target.value }));
  }
  find("time").addEventListener("input", (event) => seek(+event.target.value));
  find("play").addEventListener("click", toggle);
  find("player").addEventListener("keydown", onKey);
  for (const kind of ["pointerdown", "pointermove"]) find("plots").addEventListener(kind, onDrag);
  for (const media of [dark, matchMedia("print")]) {
    media.addEventListener("change", () => { readColours(); fillLegend(); draw(); });
  }
  new ResizeObserver(() => draw()).observe(find("field"));
  set({});

  window.player = {
    state,
    controllers: sets.map((entry) => entry.name),
    laps: (c) => sets[c].numbers.slice(),
    pose: poseAt,
    errors: errorsAt,
    set, seek, play, pause,
  };
})();
