// The page: what is shown, list and search, choosing, legend, labels. Everything from the campaign goes in as text, never as markup.

const byId = (id) => document.getElementById(id);
const scene = JSON.parse(byId('data').textContent);
const words = scene.words;
const canvas = byId('scene'), overlay = byId('overlay'), pen = overlay.getContext('2d');
const MODES = ['reflectance', 'height', 'sortie', 'strip', 'error'];
const BACKDROP = [0.085, 0.105, 0.135];
const shown = { terrain: true, targets: true, points: true, trajectory: true, cameras: true, labels: true };
const look = { mode: 0, adjusted: true, size: 2.5, range: [0, 1], share: 1 };
let painter = null, cloud = null, ground = null, bodies = null, tracks = null, frusta = null, around = null;
let chosen = null, waiting = false, frames = 0;
const orbit = new Orbit(redraw);

function element(kind, text, name) {
  const made = document.createElement(kind);
  if (text !== undefined) made.textContent = text;
  if (name) made.className = name;
  return made;
}

function redraw() {
  if (!waiting) { waiting = true; requestAnimationFrame(frame); }
}

// ---- where things are ----

function bounds() {
  const places = scene.targets.map((t) => t.at);
  if (!places.length && scene.cloud) scene.cloud.tiles.forEach((t) => places.push(t.low, add(t.low, times(t.step, 65535))));
  if (!places.length) scene.cameras.forEach((c) => places.push(c.at));
  if (!places.length) return { middle: [0, 0, 0], radius: 30 };
  const low = [0, 1, 2].map((k) => Math.min(...places.map((p) => p[k]))), high = [0, 1, 2].map((k) => Math.max(...places.map((p) => p[k])));
  return { middle: times(add(low, high), 0.5), radius: Math.max(norm(sub(high, low)) / 2, 3) };
}

const extent = bounds();
const floor = scene.targets.length ? extent.middle[2] : 0;

const range = { at: extent.middle, azimuth: -0.5, elevation: 0.62, distance: extent.radius * 2.75 };

function home() { orbit.goTo(range); }

// The range and all that was flown above it.
function whole() {
  const places = [extent.middle, ...scene.cameras.map((c) => c.at)];
  scene.tracks.forEach((t) => {
    const xyz = floats(t.places), on = bytes(t.strip);
    on.forEach((strip, i) => { if (strip) places.push([xyz[3 * i], xyz[3 * i + 1], xyz[3 * i + 2]]); });
  });
  const low = [0, 1, 2].map((k) => Math.min(...places.map((p) => p[k]))), high = [0, 1, 2].map((k) => Math.max(...places.map((p) => p[k])));
  const radius = Math.max(norm(sub(high, low)) / 2, extent.radius);
  orbit.goTo({ at: times(add(low, high), 0.5), azimuth: -0.5, elevation: 0.32, distance: radius * 3.3 });
}

// ---- drawing ----

function frame() {
  waiting = false;
  const ratio = Math.min(devicePixelRatio || 1, 2), w = canvas.clientWidth, h = canvas.clientHeight;
  if (!w || !h) return;
  for (const c of [canvas, overlay]) {
    if (c.width !== Math.round(w * ratio) || c.height !== Math.round(h * ratio)) {
      c.width = Math.round(w * ratio);
      c.height = Math.round(h * ratio);
    }
  }
  const view = orbit.view(w, h, ratio);
  if (painter) {
    painter.begin(BACKDROP);
    if (shown.terrain && ground) painter.drawMesh(ground.held, view, 1, true);
    if (shown.targets && bodies) painter.drawMesh(bodies, view, 0.75, false);
    if (shown.points && cloud) painter.drawPoints(cloud, view, look);
    if (shown.trajectory) painter.drawLines(tracks, view, false);
    if (shown.cameras) painter.drawLines(frusta, view, false);
    painter.drawLines(around, view, chosen && chosen.kind !== 'camera');
  }
  drawOverlay(view, w, h, ratio);
  frames += 1;
  const state = document.documentElement.dataset;
  state.frames = frames;
  state.camera = [...orbit.at, orbit.azimuth, orbit.elevation, orbit.distance].map((v) => v.toFixed(3)).join(' ');
}

function outlined(text, x, y, colour) {
  pen.lineWidth = 3.5;
  pen.lineJoin = 'round';
  pen.strokeStyle = 'rgba(10,14,20,.85)';
  pen.strokeText(text, x, y);
  pen.fillStyle = colour;
  pen.fillText(text, x, y);
}

function drawOverlay(view, w, h, ratio) {
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, w, h);
  pen.font = '600 12px system-ui, "Segoe UI", Roboto, "DejaVu Sans", sans-serif';
  pen.textAlign = 'center';
  pen.textBaseline = 'alphabetic';
  if (shown.labels && shown.targets) drawLabels(view, w, h);
  if (chosen && chosen.kind === 'camera') {
    const [x, y, depth] = toScreen(view.matrix, chosen.item.at, w, h);
    if (depth > 0) outlined(chosen.item.image, x, y - 10, '#ffd640');
  }
  drawNorth(w);
  drawScale(w, h);
}

function drawLabels(view, w, h) {
  const taken = [], all = scene.targets.map((t) => [t, toScreen(view.matrix, t.top, w, h)]);
  const mine = (t) => chosen && chosen.item === t;
  all.sort((a, b) => (mine(b[0]) ? 1 : 0) - (mine(a[0]) ? 1 : 0) || a[1][2] - b[1][2]);
  for (const [t, [x, y, depth]] of all) {
    if (depth <= 0 || x < 0 || x > w || y < 12 || y > h || taken.length > 300) continue;
    const half = 3.8 * t.id.length + 4, box = [x - half, y - 19, x + half, y - 3];
    if (!mine(t) && taken.some((o) => o[0] < box[2] && o[2] > box[0] && o[1] < box[3] && o[3] > box[1])) continue;
    taken.push(box);
    outlined(t.id, x, y - 7, mine(t) ? '#ffd640' : { panel: '#ffffff', frustum: '#8fe3ff', board: '#ffc9a3' }[t.kind]);
  }
}

function drawNorth() {
  const x = 38, y = byId('stage').clientHeight - 92, r = 19, a = -orbit.azimuth, flat = Math.max(Math.sin(orbit.elevation), 0.35);
  const tip = (angle, length) => [x + Math.sin(angle) * length, y - Math.cos(angle) * length * flat];
  for (const [side, colour] of [[-1, '#e8edf3'], [1, '#8b97a6']]) {
    pen.beginPath();
    pen.moveTo(...tip(a, r));
    pen.lineTo(...tip(a + side * 2.5, r * 0.72));
    pen.lineTo(...tip(a + Math.PI, r * 0.3));
    pen.fillStyle = colour;
    pen.fill();
  }
  const [nx, ny] = tip(a, r + 10);
  outlined('N', nx, ny + 4, '#ffffff');
}

function drawScale(w, h) {
  const perPixel = orbit.metresPerPixel(w, h), most = 130 * perPixel, ten = Math.pow(10, Math.floor(Math.log10(most)));
  const length = [5, 2, 1].map((k) => k * ten).find((v) => v <= most), px = length / perPixel, x = 22, y = h - 26;
  pen.fillStyle = 'rgba(10,14,20,.6)';
  pen.fillRect(x - 2, y - 2, px + 4, 8);
  pen.fillStyle = '#ffffff';
  pen.fillRect(x, y, px, 4);
  pen.textAlign = 'left';
  outlined(length >= 1 ? `${length} m` : `${+(length * 100).toPrecision(1)} cm`, x, y - 7, '#ffffff');
}

// ---- choosing ----

function setChoice(next) {
  chosen = next;
  if (painter) {
    painter.free(around);
    around = painter.lineArray(choiceLines(chosen, floor).data());
    painter.free(frusta);
    frusta = painter.lineArray(cameraLines(scene, chosen && chosen.kind === 'camera' ? chosen.item : null).data());
  }
  document.querySelectorAll('#list [aria-current]').forEach((b) => b.removeAttribute('aria-current'));
  const card = byId('card');
  card.hidden = !chosen;
  if (chosen) {
    if (chosen.button) chosen.button.setAttribute('aria-current', 'true');
    byId('card-title').textContent = chosen.title;
    byId('card-rows').replaceChildren(...chosen.rows.flatMap(([name, value]) => [element('dt', name), element('dd', value)]));
  }
  redraw();
}

function choose(kind, item, jump) {
  const name = kind === 'camera' ? item.image : item.id;
  setChoice({ kind, item, rows: item.rows, button: item.button, title: kind === 'camera' ? name : `${name} · ${words[item.kind]}` });
  if (jump && kind === 'target') orbit.goTo({ at: item.at, distance: Math.max(item.size * 7, 3), elevation: 0.75 });
  if (jump && kind === 'camera') {
    const high = Math.max(item.at[2] - floor, 5);
    orbit.goTo({ at: [item.at[0], item.at[1], floor + high * 0.45], distance: high * 2.1, elevation: 0.3 });
  }
  if (jump) byId('panel').classList.remove('open');
  byId('drawer').setAttribute('aria-expanded', byId('panel').classList.contains('open'));
}

// The shown point nearest to a place on the screen: [tile, index, distance in pixels, depth].
function nearestPoint(view, x, y, w, h, within) {
  let best = null;
  const step = look.adjusted ? cloud.shiftStep : 0, m = view.matrix;
  for (const tile of cloud.tiles) {
    for (let i = tile.first; i < tile.first + tile.count; i++) {
      const a = tile.low[0] + cloud.u16[8 * i] * tile.step[0] + cloud.i8[16 * i + 8] * step;
      const b = tile.low[1] + cloud.u16[8 * i + 1] * tile.step[1] + cloud.i8[16 * i + 9] * step;
      const c = tile.low[2] + cloud.u16[8 * i + 2] * tile.step[2] + cloud.i8[16 * i + 10] * step;
      const depth = m[3] * a + m[7] * b + m[11] * c + m[15];
      if (depth <= 0) continue;
      const px = ((m[0] * a + m[4] * b + m[8] * c + m[12]) / depth + 1) * 0.5 * w - x;
      if (px > within || px < -within) continue;
      const py = (1 - (m[1] * a + m[5] * b + m[9] * c + m[13]) / depth) * 0.5 * h - y, away = Math.hypot(px, py);
      if (away > within) continue;
      const cost = depth * (1 + 0.004 * away); // what lies in front, then what lies nearest
      if (!best || cost < best.cost) best = { tile, i, away, depth, cost };
    }
  }
  return best;
}

function pointRows(found) {
  const i = found.i, p = pointAt(cloud, found.tile, i, look.adjusted), strip = scene.strips[cloud.u8[16 * i + 6]];
  const rows = [
    [words.easting, `${(scene.origin[0] + p[0]).toFixed(3)} m`], [words.northing, `${(scene.origin[1] + p[1]).toFixed(3)} m`],
    [words.normal_height, `${(scene.origin[2] + p[2]).toFixed(3)} m`], [words.sortie, String(strip.sortie)], [words.strip, String(strip.strip)],
  ];
  const bright = cloud.u8[16 * i + 7];
  if (bright) rows.push([words.reflectance, `${(100 * (bright - 1) * cloud.reflectanceStep).toFixed(1)} %`]);
  [['delivered', 0], ['adjusted', 1]].forEach(([name, k]) => {
    const code = cloud.u8[16 * i + 12 + k];
    if (code) rows.push([`${words.error} · ${words[name]}`, metres(errorValue((code - 1) / 254))]);
  });
  return { p, rows };
}

function pick(x, y) {
  const w = canvas.clientWidth, h = canvas.clientHeight, view = orbit.view(w, h, 1);
  const perPixel = 2 * Math.tan(orbit.fieldOfView(w, h) / 2) / h;
  let best = null;
  const offer = (kind, item, away, depth) => { if (!best || depth < best.depth) best = { kind, item, away, depth }; };
  if (shown.targets) {
    for (const t of scene.targets) {
      const [px, py, depth] = toScreen(view.matrix, times(add(t.at, t.top), 0.5), w, h), away = Math.hypot(px - x, py - y);
      if (depth > 0 && away < Math.max((0.55 * t.size) / (depth * perPixel), 7)) offer('target', t, away, depth);
    }
  }
  if (shown.cameras) {
    for (const c of scene.cameras) {
      const places = [c.at, c.corners ? add(c.at, times(c.corners.reduce(add), 0.25)) : c.at];
      for (const p of places) {
        const [px, py, depth] = toScreen(view.matrix, p, w, h);
        if (depth > 0 && Math.hypot(px - x, py - y) < 12) offer('camera', c, 0, depth * 0.8);
      }
    }
  }
  if (best) { choose(best.kind, best.item, false); return; }
  const found = shown.points && cloud ? nearestPoint(view, x, y, w, h, 7) : null;
  if (!found) { setChoice(null); return; }
  const { p, rows } = pointRows(found);
  setChoice({ kind: 'point', at: p, reach: found.depth * perPixel * 9, title: words.point, rows });
}

// ---- legend ----

const errorValue = (t) => scene.cloud.error_least * Math.pow(10, t * scene.cloud.error_decades);
const metres = (v) => (v >= 0.995 ? `${v.toFixed(2)} m` : v >= 0.0995 ? `${(100 * v).toFixed(0)} cm` : v >= 0.00995 ? `${(100 * v).toFixed(1)} cm` : `${(1000 * v).toFixed(1)} mm`);

function swatch(colour, text) {
  const item = element('li', text), dot = element('span', '', 'swatch');
  dot.style.background = `rgb(${colour.join(',')})`;
  item.prepend(dot);
  return item;
}

function drawLegend() {
  const legend = byId('legend'), mode = MODES[look.mode];
  legend.replaceChildren();
  legend.hidden = !cloud || !shown.points;
  if (legend.hidden) return;
  const c = scene.cloud;
  if (mode === 'sortie' || mode === 'strip') {
    legend.append(element('h3', words[mode]));
    const list = element('ul');
    if (mode === 'sortie') scene.sorties.forEach((s) => list.append(swatch(rgb(s.colour), String(s.number))));
    else scene.strips.forEach((s, k) => list.append(swatch(stripColour(scene, k), `${s.sortie}-${s.strip}`)));
    legend.append(list);
    return;
  }
  const title = mode === 'reflectance' ? words[`reflectance_${c.reflectance_by}`] || words.reflectance : words[mode];
  legend.append(element('h3', title));
  const bar = element('canvas');
  bar.width = 200;
  bar.height = 1;
  const brush = bar.getContext('2d'), colours = scene.scales[mode], ramp = brush.createLinearGradient(0, 0, 200, 0);
  colours.forEach((hex, k) => ramp.addColorStop(k / (colours.length - 1), hex));
  brush.fillStyle = ramp;
  brush.fillRect(0, 0, 200, 1);
  const ticks = element('div', undefined, 'ticks');
  const place = (t) => mix(look.range[0], look.range[1], t);
  const texts = mode === 'error'
    ? ['1 mm', '1 cm', '10 cm', '≥ 1 m']
    : [0, 0.5, 1].map((t) => (mode === 'height' ? `${(scene.origin[2] + place(t)).toFixed(2)} m` : `${(100 * place(t)).toFixed(0)} %`));
  texts.forEach((text) => ticks.append(element('span', text)));
  legend.append(bar, ticks);
}

function setMode(name) {
  look.mode = MODES.indexOf(name);
  look.range = name === 'height' ? scene.cloud.height_range : [Math.max(0, scene.cloud.reflectance_range[0]), scene.cloud.reflectance_range[1]];
  drawLegend();
  redraw();
}

// ---- controls and list ----

function fillControls() {
  const select = byId('colour'), c = scene.cloud;
  if (c) {
    const offered = MODES.filter((m) => (m === 'reflectance' ? c.reflectance : m === 'error' ? c.error.some(Boolean) : true));
    offered.forEach((m) => { const o = element('option', words[m]); o.value = m; select.append(o); });
    select.addEventListener('change', () => setMode(select.value));
    setMode(offered[0]);
  }
  select.disabled = !c;
  byId('cloud-row').hidden = !(c && c.shift);
  look.adjusted = Boolean(c && c.shift);
  byId('cloud').addEventListener('change', (e) => { look.adjusted = e.target.value === '1'; setChoice(chosen && chosen.kind === 'point' ? null : chosen); });
  byId('size').addEventListener('input', (e) => { look.size = Number(e.target.value); redraw(); });
  document.querySelectorAll('[data-layer]').forEach((box) => box.addEventListener('change', () => {
    shown[box.dataset.layer] = box.checked;
    drawLegend();
    redraw();
  }));
  byId('home').addEventListener('click', home);
  byId('whole').addEventListener('click', whole);
  byId('top').addEventListener('click', () => orbit.goTo({ azimuth: 0, elevation: Math.PI / 2 - 1e-4 }));
  byId('card-close').addEventListener('click', () => setChoice(null));
  byId('drawer').addEventListener('click', () => byId('drawer').setAttribute('aria-expanded', byId('panel').classList.toggle('open')));
  scene.notes.forEach((line) => byId('note-lines').append(element('p', line)));
  addEventListener('keydown', (e) => { if (e.key === 'Escape') { setChoice(null); byId('panel').classList.remove('open'); } });
}

function fillList() {
  const list = byId('list'), groups = [];
  const group = (title, items, kind, name, detail) => {
    if (!items.length) return;
    const heading = element('h2', `${title} `), body = element('ul');
    heading.append(element('small', String(items.length)));
    items.forEach((item) => {
      const button = element('button', name(item));
      button.type = 'button';
      button.append(element('small', detail(item)));
      button.addEventListener('click', () => choose(kind, item, true));
      item.button = button;
      const row = element('li');
      row.append(button);
      body.append(row);
    });
    list.append(heading, body);
    groups.push([heading, body]);
  };
  for (const kind of ['frustum', 'panel', 'board']) {
    group(words[kind], scene.targets.filter((t) => t.kind === kind), 'target', (t) => t.id, (t) => t.short);
  }
  group(words.images, scene.cameras, 'camera', (c) => c.image, (c) => `${words.sortie} ${c.sortie}`);
  const none = element('p', words.nothing_found, 'soft');
  none.hidden = true;
  list.append(none);
  byId('search').addEventListener('input', (e) => {
    const wanted = e.target.value.trim().toLowerCase();
    let left = 0;
    for (const [heading, body] of groups) {
      let here = 0;
      for (const row of body.children) {
        row.hidden = !row.textContent.toLowerCase().includes(wanted);
        here += row.hidden ? 0 : 1;
      }
      heading.hidden = body.hidden = !here;
      left += here;
    }
    none.hidden = left > 0;
  });
}

// view.html#F03 opens at that target, view.html#NAME.tif at that image.
function openAddress() {
  let name = '';
  try { name = decodeURIComponent(location.hash.slice(1)); } catch { return; }
  const target = scene.targets.find((t) => t.id === name), image = scene.cameras.find((c) => c.image === name);
  if (target) choose('target', target, true);
  else if (image) choose('camera', image, true);
}

function notice(text) {
  byId('notice').textContent = text;
  byId('notice').hidden = false;
}

function begin() {
  try {
    painter = new Painter(canvas);
  } catch (error) {
    notice(words.no_webgl);
  }
  cloud = decodeCloud(scene, painter);
  ground = scene.terrain ? decodeTerrain(scene.terrain, painter) : null;
  bodies = targetMesh(scene, painter);
  if (painter) {
    tracks = painter.lineArray(trackLines(scene).data());
    frusta = painter.lineArray(cameraLines(scene, null).data());
    canvas.addEventListener('webglcontextlost', (e) => { e.preventDefault(); painter = null; notice(words.no_webgl); });
  }
  if (!scene.cloud && !scene.targets.length && !scene.cameras.length && !scene.tracks.length) notice(words.empty);
  orbit.limit = extent.radius * 40 + 500;
  Object.assign(orbit, range);
  orbit.reach = orbit.distance;
  fillControls();
  fillList();
  orbit.listen(canvas, pick, home);
  new ResizeObserver(redraw).observe(byId('stage'));
  addEventListener('hashchange', openAddress);
  openAddress();
  redraw();
  document.documentElement.dataset.state = painter ? 'drawn' : 'no-webgl';
}

begin();
