// The camera: it looks at a point from a direction and a distance; mouse, touch and keys turn, move and zoom it. Draws nothing.

const FIELD_OF_VIEW = 0.75;

class Orbit {
  constructor(changed) {
    this.at = [0, 0, 0];
    this.azimuth = -0.6; // of the view's direction, from north, clockwise
    this.elevation = 0.6;
    this.distance = 100;
    this.limit = 1e5;
    this.changed = changed;
    this.flight = 0;
  }

  axes() {
    const ce = Math.cos(this.elevation), se = Math.sin(this.elevation), ca = Math.cos(this.azimuth), sa = Math.sin(this.azimuth);
    const back = [-sa * ce, -ca * ce, se];
    return { right: [ca, -sa, 0], up: [sa * se, ca * se, ce], back };
  }

  view(width, height, ratio) {
    const { right, up, back } = this.axes(), eye = add(this.at, times(back, this.distance));
    const far = this.distance * 4 + 3000, near = Math.max(0.05, this.distance / 400);
    const matrix = multiply(perspective(this.fieldOfView(width, height), width / height, near, far), lookAt(eye, right, up, back));
    return { matrix, eye, right, up, back, ratio, reach: this.reach || this.distance };
  }

  // On a tall screen the width is what is short: the same scene fits in.
  fieldOfView(width, height) {
    return width >= height ? FIELD_OF_VIEW : 2 * Math.atan(Math.tan(FIELD_OF_VIEW / 2) * Math.min(1.6, height / width));
  }

  metresPerPixel(width, height) {
    return (2 * Math.tan(this.fieldOfView(width, height) / 2) * this.distance) / height;
  }

  turn(azimuth, elevation) {
    this.stop();
    this.azimuth += azimuth;
    this.elevation = clamp(this.elevation + elevation, -0.1, Math.PI / 2 - 1e-4);
    this.changed();
  }

  // Moves what is looked at along the ground, by metres to the right and ahead.
  move(right, ahead) {
    this.stop();
    const ca = Math.cos(this.azimuth), sa = Math.sin(this.azimuth);
    this.at = [
      clamp(this.at[0] + right * ca + ahead * sa, -this.limit, this.limit),
      clamp(this.at[1] - right * sa + ahead * ca, -this.limit, this.limit), this.at[2],
    ];
    this.changed();
  }

  zoom(factor) {
    this.stop();
    this.distance = clamp(this.distance * factor, 0.4, this.limit);
    this.changed();
  }

  stop() { cancelAnimationFrame(this.flight); }

  // Flies there in 0.7 s, or is there at once where the reader asked for less motion.
  goTo(goal) {
    this.stop();
    const from = { at: this.at, azimuth: this.azimuth, elevation: this.elevation, distance: this.distance };
    const to = { ...from, ...goal };
    const turn = ((((to.azimuth - from.azimuth + Math.PI) % (2 * Math.PI)) + 2 * Math.PI) % (2 * Math.PI)) - Math.PI;
    const begin = performance.now();
    const still = matchMedia('(prefers-reduced-motion: reduce)').matches;
    const step = (now) => {
      const t = still ? 1 : clamp((now - begin) / 700, 0, 1), s = t * t * (3 - 2 * t);
      this.at = [0, 1, 2].map((k) => mix(from.at[k], to.at[k], s));
      this.azimuth = from.azimuth + turn * s;
      this.elevation = mix(from.elevation, to.elevation, s);
      this.distance = Math.exp(mix(Math.log(from.distance), Math.log(to.distance), s));
      this.changed();
      if (t < 1) this.flight = requestAnimationFrame(step);
    };
    step(begin);
  }

  // `clicked(x, y)`: a press without a drag.
  listen(canvas, clicked, home) {
    const down = new Map();
    let moved = 0;
    const scale = () => this.metresPerPixel(canvas.clientWidth, canvas.clientHeight);
    canvas.addEventListener('contextmenu', (e) => e.preventDefault());
    canvas.addEventListener('pointerdown', (e) => {
      canvas.setPointerCapture(e.pointerId);
      down.set(e.pointerId, [e.clientX, e.clientY]);
      if (down.size === 1) moved = 0;
    });
    canvas.addEventListener('pointermove', (e) => {
      const before = down.get(e.pointerId);
      if (!before) return;
      const dx = e.clientX - before[0], dy = e.clientY - before[1];
      moved += Math.abs(dx) + Math.abs(dy);
      if (down.size === 1) {
        if (moved < 4) return;
        const pan = e.buttons === 2 || e.buttons === 4 || e.shiftKey || e.ctrlKey;
        const flat = Math.max(Math.sin(Math.max(this.elevation, 0)), 0.25);
        if (pan) this.move(-dx * scale(), (dy * scale()) / flat);
        else this.turn(dx * 0.006, dy * 0.006);
      } else {
        const other = [...down].find(([id]) => id !== e.pointerId)[1];
        const apart = (p) => Math.hypot(p[0] - other[0], p[1] - other[1]) || 1;
        this.zoom(apart(before) / apart([e.clientX, e.clientY]));
        this.move(-0.5 * dx * scale(), 0.5 * dy * scale());
      }
      down.set(e.pointerId, [e.clientX, e.clientY]);
    });
    const up = (e) => {
      const press = down.delete(e.pointerId);
      if (e.type === 'pointerup' && press && moved < 4 && !down.size && e.button === 0) {
        const box = canvas.getBoundingClientRect();
        clicked(e.clientX - box.left, e.clientY - box.top);
      }
    };
    canvas.addEventListener('pointerup', up);
    canvas.addEventListener('pointercancel', up);
    canvas.addEventListener('wheel', (e) => {
      e.preventDefault();
      this.zoom(Math.exp(clamp(e.deltaY * (e.deltaMode ? 20 : 1), -300, 300) * 0.0015));
    }, { passive: false });
    canvas.addEventListener('keydown', (e) => {
      const arrows = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[e.key];
      if (e.altKey || e.metaKey || e.ctrlKey) return;
      if (arrows && e.shiftKey) this.move(...times([...arrows, 0], 40 * scale()).slice(0, 2));
      else if (arrows) this.turn(0.1 * arrows[0], 0.08 * arrows[1]);
      else if (e.key === '+' || e.key === '=') this.zoom(0.8);
      else if (e.key === '-') this.zoom(1.25);
      else if (e.key === '0' || e.key === 'Home') home();
      else return;
      e.preventDefault();
    });
  }
}
