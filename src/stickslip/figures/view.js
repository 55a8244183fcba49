// Controls and motion of the view; runs in K3D's snapshot page, where K3DInstance is defined.
"use strict";
const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
const floats = (text) => new Float32Array(bytes(text).buffer);
const data = JSON.parse(fflate.strFromU8(fflate.unzlibSync(bytes("[DATA]"))));
const view = K3DInstance, world = view.getWorld(), target = document.getElementById("canvasTarget");
const byName = {};
for (const object of Object.values(world.ObjectsListJson)) byName[object.name] = object;

const radius = floats(data.radius), top = 1.05 * radius.reduce((a, b) => Math.max(a, b), 0);
const modes = data.modes.map((m) => ({ words: m.words, re: floats(m.re), im: floats(m.im) }));
const frames = data.frames.map((f) => ({ label: f.label, packed: f }));
const now = {
  frame: modes.length ? data.mode_frame : data.start, shown: data.shown, mode: modes.length ? 0 : -1, moving: false, playing: false, phase: 0,
  amplitude: 0.3, size: data.dim === 2 ? 1 : 0.6, contacts: true, box: true,
};

function unpacked(k) { // arrays of a frame, decoded on first use
  const f = frames[k];
  if (!f.position) {
    const p = f.packed;
    f.position = floats(p.position);
    f.i = new Int32Array(bytes(p.i).buffer);
    f.j = new Int32Array(bytes(p.j).buffer);
    f.branch = floats(p.branch);
    f.lines = data.widths.flatMap((_, size) => data.lines.map((kind) => ({ name: `${kind} ${size}`, rows: [] })));
    const size = bytes(p.size), kind = bytes(p.mode);
    for (let c = 0; c < size.length; c++) f.lines[data.lines.length * size[c] + kind[c]].rows.push(c);
    f.lines = f.lines.filter((line) => byName[line.name]); // bonds have one width
    f.values = Object.fromEntries(Object.entries(p.values).map(([name, text]) => [name, floats(text)]));
    f.edges = floats(p.edges);
    f.walls = floats(p.walls);
  }
  return f;
}

function shifts() { // displacements of the mode at this phase, or null
  if (now.mode < 0 || now.frame !== data.mode_frame || now.amplitude === 0) return null;
  const { re, im } = modes[now.mode], c = now.amplitude * Math.cos(now.phase), s = now.amplitude * Math.sin(now.phase);
  const out = new Float32Array(re.length);
  for (let k = 0; k < out.length; k++) out[k] = c * re[k] + s * im[k]; // Re(u exp(-iφ)), as exp(st) with Im s < 0
  return out;
}

function moved(f, u) {
  if (!u) return f.position;
  const out = new Float32Array(f.position.length);
  for (let k = 0; k < out.length; k++) out[k] = f.position[k] + u[k];
  return out;
}

function segments(f, rows, at, u) { // from the centre of i to that of j, as the branch vector says
  const out = new Float32Array(6 * Math.max(rows.length, 1)), lift = data.dim === 2 ? top : 0, n = radius.length;
  for (let m = 0; m < rows.length; m++) {
    const c = rows[m], i = 3 * f.i[c], j = 3 * f.j[c], follows = u !== null && f.j[c] < n;
    for (let a = 0; a < 3; a++) {
      const z = a === 2 ? lift : 0;
      out[6 * m + a] = at[i + a] + z;
      out[6 * m + 3 + a] = f.position[i + a] - f.branch[3 * c + a] + (follows ? u[j + a] : 0) + z;
    }
  }
  return out;
}

function put(name, field, values) { // set a field of a drawn object; arrays of unchanged length are updated in place
  const object = byName[name], before = object[field];
  const shape = field === "colors" || field === "point_sizes" ? [values.length] : [values.length / 3, 3];
  const same = before && before.data && before.data.length === values.length;
  object[field] = { data: values, shape };
  if (!same && field === "vertices") {
    object.indices = { data: Uint32Array.from({ length: values.length / 3 }, (_, k) => k), shape: [values.length / 3] };
  }
  return view.reload(object, same ? { [field]: object[field] } : null, true);
}

function place(u) {
  const f = unpacked(now.frame), at = moved(f, u), work = [put("grains", "positions", at)];
  if (now.contacts) for (const line of f.lines) work.push(put(line.name, "vertices", segments(f, line.rows, at, u)));
  return Promise.all(work).then(() => view.render());
}

function show(name, visible) {
  byName[name].visible = visible;
  return view.reload(byName[name], null, true);
}

function paint() {
  const about = data.quantities[now.shown], values = unpacked(now.frame).values[about.name];
  const span = about.high - about.low || 1;
  const colour = about.kinds
    ? (v) => data.colours.kinds[Math.max(about.kinds.indexOf(Math.round(v)), 0) % data.colours.kinds.length]
    : (v) => data.map[Math.round(255 * Math.min(Math.max((v - about.low) / span, 0), 1))];
  legend(about);
  return put("grains", "colors", Uint32Array.from(values, colour)).then(() => view.render());
}

function resize() {
  return put("grains", "point_sizes", radius.map((r) => 2 * r * now.size)).then(() => view.render());
}

function fit() { // as close as the bounding box of all frames allows, in a canvas of any shape
  const box = target.getBoundingClientRect(), t = Math.tan((data.fov * Math.PI) / 360);
  const wide = (t * box.width) / Math.max(box.height, 1), [right, up, toward] = data.eye;
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const middle = [0, 1, 2].map((a) => 0.5 * (data.box[0][a] + data.box[1][a]));
  let away = 0;
  for (let corner = 0; corner < 8; corner++) {
    const p = [0, 1, 2].map((a) => data.box[(corner >> a) & 1][a] - middle[a]);
    away = Math.max(away, dot(p, toward) + Math.max(Math.abs(dot(p, up)) / t, Math.abs(dot(p, right)) / wide));
  }
  view.setCamera([...middle.map((m, a) => m + 1.04 * away * toward[a]), ...middle, ...up]);
  view.render();
}

async function frame(k) {
  now.frame = k;
  const f = unpacked(k);
  put("edges", "vertices", f.edges.length ? f.edges : new Float32Array(6));
  put("walls", "vertices", f.walls.length ? f.walls : new Float32Array(6));
  await place(shifts());
  await paint();
  if (slider) { slider.value = k; slider.tell(); }
  document.getElementById("when").textContent = f.label;
}

let last = 0, counted = 0, since = 0;
const period = 2500; // of a mode on the screen [ms]
async function tick(time) { // one picture after the other, as fast as the machine can draw
  if (now.moving) {
    now.phase = (now.phase + (2 * Math.PI * Math.min(time - last, 100)) / period) % (2 * Math.PI);
    await place(shifts());
  } else if (now.playing && time - since > 120) {
    since = time;
    await frame((now.frame + 1) % frames.length);
  }
  last = time;
  counted += 1;
  window.stickslip.pictures = counted;
  if (now.moving || now.playing) requestAnimationFrame(tick);
}

function run(what, on) {
  const idle = !now.moving && !now.playing;
  now[what] = on;
  if (what === "moving" && on) { now.playing = false; if (now.frame !== data.mode_frame) frame(data.mode_frame); }
  if (what === "playing" && on) now.moving = false;
  for (const [name, button] of [["moving", swing], ["playing", play]]) {
    if (button) { button.setAttribute("aria-pressed", now[name]); button.textContent = button.words[Number(now[name])]; }
  }
  if (idle && on) { last = performance.now(); requestAnimationFrame(tick); }
}

// ---- controls: plain elements below the picture
const style = document.createElement("style");
style.textContent = `
  :root { color-scheme: light dark; --ink: #222; --paper: #fff; --shade: #fafafa; --rule: #ddd; }
  @media (prefers-color-scheme: dark) { :root { --ink: #e4e7ea; --paper: #14171a; --shade: #1d2226; --rule: #363d44; } }
  html, body { height: 100%; margin: 0; overflow: hidden; background: var(--paper); color: var(--ink);
    font: 14px/1.4 system-ui, sans-serif; }
  body { display: flex; flex-direction: column; }
  #canvasTarget { position: relative !important; flex: 1 1 0; min-height: 0; height: auto !important; }
  #controls { display: flex; flex-wrap: wrap; gap: .35rem .9rem; align-items: center; padding: .45rem .7rem;
    border-top: 1px solid var(--rule); background: var(--shade); }
  #when { font-variant-numeric: tabular-nums; font-weight: 600; }
  #controls output { min-width: 4.2em; font-variant-numeric: tabular-nums; }
  #controls label { display: inline-flex; gap: .35rem; align-items: center; white-space: nowrap; }
  #controls input[type=range] { width: 7rem; }
  #controls button, #controls select { font: inherit; padding: .15rem .5rem; max-width: 16rem; }
  #controls button[aria-pressed=true] { background: #0072b2; color: #fff; border-color: #0072b2; }
  #legend { display: flex; align-items: center; gap: .4rem; flex-basis: 100%; flex-wrap: wrap; font-size: 13px; }
  #bar { width: 9rem; height: .8rem; border: 1px solid #999; }
  @media (max-width: 40rem) { #controls { gap: .2rem .7rem; font-size: 13px; } #controls input[type=range] { width: 5rem; }
    #controls select { max-width: 10rem; } }
  .swatch { display: inline-block; width: .9rem; height: .8rem; border: 1px solid #777; vertical-align: -1px; }
  .line { display: inline-block; width: 1.2rem; height: .25rem; vertical-align: 3px; }`;
document.head.appendChild(style);
const panel = document.createElement("div");
panel.id = "controls";
document.body.appendChild(panel);
document.documentElement.lang = "en";

function element(kind, options, words) {
  const e = Object.assign(document.createElement(kind), options);
  if (!words) { panel.appendChild(e); return e; }
  const label = document.createElement("label");
  label.append(words, e);
  panel.appendChild(label);
  return e;
}
function button(id, words, act) {
  const e = element("button", { id, textContent: words[0], words, type: "button" });
  e.addEventListener("click", act);
  return e;
}
function range(id, words, value, most, step, act, said) { // `said` turns the value into text beside the slider
  const e = element("input", { id, type: "range", min: 0, max: most, step, value }, words);
  e.value = value;
  const text = Object.assign(document.createElement("output"), { id: `${id}-value` });
  e.after(text);
  e.tell = () => { text.textContent = said(Number(e.value)); };
  e.tell();
  e.addEventListener("input", () => { act(Number(e.value)); e.tell(); });
  return e;
}
function choice(id, words, names, value, act) {
  const e = element("select", { id }, words);
  names.forEach((name, k) => e.add(new Option(name, k)));
  e.value = value;
  e.addEventListener("change", () => act(Number(e.value)));
  return e;
}
function tick_box(id, words, on, act) {
  const e = element("input", { id, type: "checkbox", checked: on }, words);
  e.addEventListener("change", () => act(e.checked));
  return e;
}

choice("colour", "colour by", data.quantities.map((q) => q.name), now.shown, (k) => { now.shown = k; paint(); });
range("size", "grain size", now.size, 1, 0.05, (v) => { now.size = Math.max(v, 0.02); resize(); },
  (v) => `${Math.round(100 * v)} %`);
tick_box("contacts", "contacts", true, async (on) => {
  now.contacts = on;
  for (const line of unpacked(now.frame).lines) await show(line.name, on);
  await place(shifts());
});
if (data.frames.some((f) => f.edges || f.walls)) {
  tick_box("box", "cell and walls", true, async (on) => {
    await show("edges", on); await show("walls", on); view.render();
  });
}
let swing = null, play = null, slider = null;
if (modes.length) {
  if (modes.length > 1) {
    choice("mode", "mode", modes.map((m, k) => `${k}: ${m.words}`), 0, (k) => { now.mode = k; frame(data.mode_frame); });
  }
  swing = button("swing", ["move the mode", "stop the mode"], () => run("moving", !now.moving));
  range("amplitude", "amplitude", now.amplitude, 1, 0.02, (v) => { now.amplitude = v; if (!now.moving) place(shifts()); },
    (v) => `${v.toFixed(2)} radii`);
}
if (frames.length > 1) {
  play = button("play", ["play", "pause"], () => run("playing", !now.playing));
  slider = range("frame", "frame", now.frame, frames.length - 1, 1, (k) => { run("playing", false); run("moving", false); frame(k); },
    (k) => `${k + 1} of ${frames.length}`);
}
button("reset", ["reset the view"], fit);
element("span", { id: "when" });
const key = element("div", { id: "legend" });

function legend(about) {
  const number = (v) => Number(v.toPrecision(3)).toString();
  const hex = (v) => `#${v.toString(16).padStart(6, "0")}`;
  const words = (text) => Object.assign(document.createElement("span"), { textContent: text });
  const parts = [words(`${about.name}${about.unit ? ` [${about.unit}]` : ""}:`)];
  if (about.kinds) {
    about.kinds.forEach((v, k) => parts.push(swatch("swatch", hex(data.colours.kinds[k % data.colours.kinds.length])), words(v)));
  } else {
    const bar = swatch("", `linear-gradient(to right, ${data.map.filter((_, k) => k % 17 === 0).map(hex).join(",")})`);
    bar.id = "bar";
    parts.push(words(number(about.low)), bar, words((about.cut ? "≥ " : "") + number(about.high)));
  }
  const names = { stick: "sticks", slide: "slides", bond: "bond", broken: "broken bond" };
  const kinds = data.lines.flatMap((kind) => [swatch("line", hex(data.colours[kind])), words(names[kind])]);
  key.replaceChildren(...parts, words("— contacts, wider with force:"), ...kinds);
}
function swatch(name, background) {
  const e = document.createElement("span");
  e.className = name;
  e.style.background = background;
  return e;
}

const dark = window.matchMedia("(prefers-color-scheme: dark)");
function shade() { // the picture itself, lines of the cell and of walls
  view.setClearColor(dark.matches ? 0x14171a : 0xffffff);
  byName.edges.color = dark.matches ? 0x9aa4ae : 0x555555;
  byName.walls.color = dark.matches ? 0xc9a66b : 0x8a6d3b;
  return Promise.all(["edges", "walls"].map((name) => view.reload(byName[name], null, true))).then(() => view.render());
}
dark.addEventListener("change", shade);

window.stickslip = { data, now, view, pictures: 0, place: () => place(shifts()) };
resize().then(() => frame(now.frame)).then(shade).then(() => { fit(); window.stickslip.ready = true; if (modes.length) run("moving", true); });
new ResizeObserver(() => { // K3D resizes with a delay
  window.dispatchEvent(new Event("resize"));
  setTimeout(fit, 100);
}).observe(target);
