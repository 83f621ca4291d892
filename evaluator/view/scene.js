// The scene's data into buffers: points, ground, targets, trajectories, camera frusta. No input and no page here.

const YELLOW = [255, 214, 64, 255];

// Collects line segments: 32 bytes each.
class Lines {
  constructor() { this.parts = []; }

  add(from, to, tint, width) { this.parts.push([from, to, tint, width]); }

  loop(corners, tint, width) { corners.forEach((c, i) => this.add(c, corners[(i + 1) % corners.length], tint, width)); }

  data() {
    const out = new ArrayBuffer(32 * this.parts.length), f = new Float32Array(out), b = new Uint8Array(out);
    this.parts.forEach(([from, to, tint, width], i) => {
      f.set(from, 8 * i);
      f.set(to, 8 * i + 3);
      b.set(tint, 32 * i + 24);
      f[8 * i + 7] = width;
    });
    return out;
  }
}

function stripColour(scene, k) { return rgb(scene.groups[k % scene.groups.length]); }

function sortieColour(scene, number) {
  const found = scene.sorties.find((s) => s.number === number);
  return found ? rgb(found.colour) : [200, 200, 200];
}

function decodeCloud(scene, painter) {
  const c = scene.cloud;
  if (!c) return null;
  const n = c.shown, place = shorts(c.place), strip = bytes(c.strip), none = new Uint8Array(n);
  const shift = c.shift ? new Int8Array(bytes(c.shift).buffer) : null;
  const bright = c.reflectance ? bytes(c.reflectance) : none;
  const errors = c.error.map((e) => (e ? bytes(e) : none));
  const packed = new ArrayBuffer(16 * n), u16 = new Uint16Array(packed), u8 = new Uint8Array(packed), i8 = new Int8Array(packed);
  for (let i = 0; i < n; i++) {
    for (let k = 0; k < 3; k++) {
      u16[8 * i + k] = place[3 * i + k];
      if (shift) i8[16 * i + 8 + k] = shift[3 * i + k];
    }
    u8[16 * i + 6] = strip[i];
    u8[16 * i + 7] = bright[i];
    u8[16 * i + 12] = errors[0][i];
    u8[16 * i + 13] = errors[1][i];
  }
  const names = ['reflectance', 'height', 'error'];
  const scales = new Uint8Array(names.flatMap((k) => scene.scales[k].flatMap(rgb)));
  const groups = new Uint8Array(2 * 256 * 3);
  scene.strips.forEach((s, k) => {
    groups.set(sortieColour(scene, s.sortie), 3 * k);
    groups.set(stripColour(scene, k), 3 * (256 + k));
  });
  let first = 0;
  const tiles = c.tiles.map((t) => { const tile = { ...t, first }; first += t.count; return tile; });
  return {
    held: painter && painter.pointArray(packed), tiles, u16, i8, u8, shown: n,
    shiftStep: c.shift ? c.shift_step : 0, reflectanceStep: c.reflectance_step,
    scales: painter && painter.texture(scene.scales.height.length, 3, scales, true),
    groups: painter && painter.texture(256, 2, groups, false),
  };
}

// Place of point i of a tile; `adjusted` as in the shader.
function pointAt(cloud, tile, i, adjusted) {
  const s = adjusted ? cloud.shiftStep : 0;
  return [0, 1, 2].map((k) => tile.low[k] + cloud.u16[8 * i + k] * tile.step[k] + cloud.i8[16 * i + 8 + k] * s);
}

function decodeTerrain(t, painter) {
  const height = shorts(t.height), bright = bytes(t.reflectance), w = t.columns, h = t.rows, gone = 65535;
  const data = new ArrayBuffer(28 * w * h), f = new Float32Array(data), b = new Uint8Array(data), indices = [];
  const z = (x, y) => {
    const code = height[clamp(y, 0, h - 1) * w + clamp(x, 0, w - 1)];
    return code === gone ? NaN : t.base + code * t.step;
  };
  for (let y = 0; y < h; y++) {
    for (let x = 0; x < w; x++) {
      const i = y * w + x, here = z(x, y);
      const slope = (a, c) => (Number.isFinite(a) && Number.isFinite(c) ? (a - c) / (2 * t.cell) : 0);
      f.set([t.low[0] + x * t.cell, t.low[1] + y * t.cell, Number.isFinite(here) ? here : 0], 7 * i);
      f.set(unit([-2.5 * slope(z(x + 1, y), z(x - 1, y)), -2.5 * slope(z(x, y + 1), z(x, y - 1)), 1]), 7 * i + 3);
      const g = 0.55 + 0.9 * clamp(bright[i] / 200, 0, 0.6);
      b.set([80 * g, 88 * g, 76 * g, 255], 28 * i + 24);
      if (x + 1 < w && y + 1 < h && [i, i + 1, i + w, i + w + 1].every((k) => height[k] !== gone)) {
        indices.push(i, i + 1, i + w + 1, i, i + w + 1, i + w);
      }
    }
  }
  const ground = (p) => z(Math.round((p[0] - t.low[0]) / t.cell), Math.round((p[1] - t.low[1]) / t.cell));
  return { held: painter && painter.meshArray(data, new Uint32Array(indices)), ground };
}

// Target frame to scene: x right, y along the azimuth (clockwise from grid north), z up.
function placed(target, p) {
  const s = Math.sin(target.azimuth), c = Math.cos(target.azimuth), k = target.size;
  return [target.at[0] + k * (c * p[0] + s * p[1]), target.at[1] + k * (-s * p[0] + c * p[1]), target.at[2] + k * p[2]];
}

function targetMesh(scene, painter) {
  const shapes = scene.templates.map((t) => ({ xyz: floats(t.xyz), grey: t.grey, top: t.top }));
  const corners = [], colours = [];
  for (const t of scene.targets) {
    const shape = shapes[t.template];
    for (let i = 0; i < shape.grey.length; i++) {
      for (let k = 0; k < 3; k++) corners.push(placed(t, Array.from(shape.xyz.slice(9 * i + 3 * k, 9 * i + 3 * k + 3))));
      // display grey of a reflectance: about the sRGB curve, so that 5 % is dark and not black
      const own = shape.grey[i] < 0, v = 255 * Math.pow(clamp(own ? t.grey : shape.grey[i], 0.02, 1), 0.55);
      colours.push(own || t.kind !== 'frustum' || shape.grey[i] > 0.9 || shape.grey[i] < 0.1 ? [v, v, v] : [0.93 * v, 0.97 * v, v]);
    }
    const half = 0.2, top = -0.02, low = -t.stand / t.size - 0.02; // the stand's column
    if (t.stand > 0.03) {
      const ring = [[-half, -half], [half, -half], [half, half], [-half, half]];
      ring.forEach((a, i) => {
        const n = ring[(i + 1) % 4];
        const quad = [[...a, low], [...n, low], [...n, top], [...a, low], [...n, top], [...a, top]];
        quad.forEach((p) => corners.push(placed(t, p)));
        colours.push([92, 96, 104], [92, 96, 104]);
      });
    }
  }
  const data = new ArrayBuffer(28 * corners.length), f = new Float32Array(data), b = new Uint8Array(data);
  for (let i = 0; i < corners.length; i += 3) {
    const n = unit(cross(sub(corners[i + 1], corners[i]), sub(corners[i + 2], corners[i])));
    for (let k = 0; k < 3; k++) {
      f.set(corners[i + k], 7 * (i + k));
      f.set(n, 7 * (i + k) + 3);
      b.set([...colours[i / 3], 255], 28 * (i + k) + 24);
    }
  }
  scene.targets.forEach((t) => { t.top = add(t.at, [0, 0, t.size * shapes[t.template].top]); });
  return painter && corners.length ? painter.meshArray(data, Uint32Array.from(corners.keys())) : null;
}

function trackLines(scene) {
  const lines = new Lines();
  for (const track of scene.tracks) {
    const xyz = floats(track.places), on = bytes(track.strip), colour = sortieColour(scene, track.sortie);
    for (let i = 0; i + 1 < on.length; i++) {
      const a = xyz.slice(3 * i, 3 * i + 3), b = xyz.slice(3 * i + 3, 3 * i + 6), strip = on[i] && on[i + 1];
      lines.add(a, b, [...colour, strip ? 255 : 110], strip ? 3.2 : 1.3);
    }
  }
  return lines;
}

function cameraLines(scene, chosen) {
  const lines = new Lines();
  for (const c of scene.cameras) {
    const own = c === chosen, tint = own ? YELLOW : [...sortieColour(scene, c.sortie).map((v) => mix(v, 255, 0.45)), 230], w = own ? 2.6 : 1.3;
    if (!c.corners) { lines.add(sub(c.at, [0.5, 0, 0]), add(c.at, [0.5, 0, 0]), tint, 4); continue; }
    const ends = c.corners.map((e) => add(c.at, e));
    ends.forEach((e) => lines.add(c.at, e, tint, w));
    lines.loop(ends, tint, w);
    const middle = times(add(ends[0], ends[1]), 0.5), out = sub(middle, times(add(ends[2], ends[3]), 0.5)); // the image's top
    lines.add(ends[0], add(middle, times(out, 0.15)), tint, w);
    lines.add(ends[1], add(middle, times(out, 0.15)), tint, w);
  }
  return lines;
}

// What is drawn round the chosen thing: a target's square and pole, an image's footprint on the ground.
function choiceLines(chosen, floor) {
  const lines = new Lines();
  if (!chosen) return lines;
  if (chosen.kind === 'camera' && chosen.item.corners) {
    const c = chosen.item;
    const feet = c.corners.map((e) => add(c.at, times(e, e[2] < -1e-3 ? (floor - c.at[2]) / e[2] : 8)));
    feet.forEach((p) => lines.add(c.at, p, [255, 214, 64, 120], 1.2));
    lines.loop(feet, YELLOW, 2.2);
  } else if (chosen.kind === 'target') {
    const t = chosen.item, square = [[-0.62, -0.62], [0.62, -0.62], [0.62, 0.62], [-0.62, 0.62]].map((p) => placed(t, [...p, 0.01]));
    lines.loop(square, YELLOW, 2.4);
    lines.add(placed(t, [0, 0.62, 0.01]), placed(t, [0, 1.05, 0.01]), YELLOW, 2.4); // heading: the target's own +y
    lines.add(placed(t, [0, 1.05, 0.01]), placed(t, [-0.12, 0.88, 0.01]), YELLOW, 2.4);
    lines.add(placed(t, [0, 1.05, 0.01]), placed(t, [0.12, 0.88, 0.01]), YELLOW, 2.4);
  } else if (chosen.kind === 'point') {
    const p = chosen.at, r = chosen.reach;
    lines.add(sub(p, [r, 0, 0]), add(p, [r, 0, 0]), YELLOW, 2);
    lines.add(sub(p, [0, r, 0]), add(p, [0, r, 0]), YELLOW, 2);
    lines.add(sub(p, [0, 0, r]), add(p, [0, 0, r]), YELLOW, 2);
  }
  return lines;
}
