'use strict';
(() => {
const data = JSON.parse(document.getElementById('data').textContent);
const byId = id => document.getElementById(id);
const bytes = text => {
  const raw = atob(text), out = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) out[i] = raw.charCodeAt(i);
  return out.buffer;
};
const STATES = ['idle', 'running', 'holding', 'held', 'stopping', 'stopped', 'dwell', 'program stop', 'fault', 'done'];
const STATE_COLOURS = ['--line', '--s2', '--s1', '--s1', '--s6', '--s6', '--s0', '--s3', '--bad', '--line'];
const KINDS = ['', 'state', 'alarm', 'command', 'override', 'hold', 'resume', 'starvation', 'late', 'loss', 'message', 'stop', 'warning', 'job', 'switched'];
const colour = name => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const short = value => {
  const size = Math.abs(value);
  if (size === 0) return '0';
  if (size >= 1e6 || size < 1e-3) return value.toExponential(2).replace('e+', 'e');
  return String(+value.toPrecision(size >= 1000 ? 5 : 4));
};
const seconds = value => value.toFixed(3);

// --- canvases: as sharp as the screen, and drawn again when anything changes
const painters = new Map();
const paint = (canvas, draw) => painters.set(canvas, draw);
function refresh(canvas) {
  const scale = window.devicePixelRatio || 1;
  const width = canvas.clientWidth, height = canvas.clientHeight;
  if (!width || !height) return;
  canvas.width = Math.round(width * scale);
  canvas.height = Math.round(height * scale);
  const pen = canvas.getContext('2d');
  pen.setTransform(scale, 0, 0, scale, 0, 0);
  pen.clearRect(0, 0, width, height);
  pen.font = '12px system-ui, sans-serif';
  painters.get(canvas)(pen, width, height);
}
let waiting = false;
function refreshAll() {
  if (waiting) return;
  waiting = true;
  requestAnimationFrame(() => { waiting = false; for (const canvas of painters.keys()) refresh(canvas); });
}
const refreshNow = () => { for (const canvas of painters.keys()) refresh(canvas); };

function ticks(low, high, count) {
  const raw = (high - low) / count, power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map(n => n * power).find(n => n >= raw);
  const list = [];
  for (let n = Math.ceil(low / step); n * step <= high + 1e-9 * step; n++) list.push(+(n * step).toPrecision(12));
  return list;
}

// --- curves: pairs of least and greatest, ever coarser by pairs
class Curve {
  constructor(series) {
    Object.assign(this, series);
    const values = new Uint16Array(bytes(series.values));
    delete this.values;
    this.levels = [values];
    while (this.levels[this.levels.length - 1].length > 64) {
      const fine = this.levels[this.levels.length - 1];
      const pairs = fine.length >> 1, coarse = new Uint16Array(((pairs + 1) >> 1) * 2);
      for (let i = 0; i < pairs; i += 2) {
        const last = Math.min(i + 1, pairs - 1);
        coarse[i] = Math.min(fine[2 * i], fine[2 * last]);
        coarse[i + 1] = Math.max(fine[2 * i + 1], fine[2 * last + 1]);
      }
      this.levels.push(coarse);
    }
  }
  value(whole) { return Math.min(Math.max(this.offset + whole * this.scale, this.least), this.greatest); }
  // Least and greatest from sample a to sample b.
  range(a, b) {
    let level = 0, width = this.width;
    while (level + 1 < this.levels.length && (b - a) / width > 64) { level++; width *= 2; }
    const list = this.levels[level], pairs = list.length >> 1;
    let low = 65535, high = 0;
    const from = Math.max(0, Math.floor(a / width)), to = Math.min(pairs - 1, Math.floor(b / width));
    for (let i = from; i <= to; i++) {
      if (list[2 * i] > list[2 * i + 1]) continue;
      if (list[2 * i] < low) low = list[2 * i];
      if (list[2 * i + 1] > high) high = list[2 * i + 1];
    }
    return low > high ? null : [this.value(low), this.value(high)];
  }
}
const curves = data.series.map(series => new Curve(series));
const samples = Math.max(1, data.last - data.first + 1);
const view = { from: 0, to: samples };
const timeOf = sample => (data.first + sample) * data.period_s;
let marked = null;

function setView(from, to) {
  const least = Math.min(samples, 20), width = Math.min(samples, Math.max(least, to - from));
  view.from = Math.max(0, Math.min(samples - width, from));
  view.to = view.from + width;
  refreshAll();
}

const LEFT = 78, RIGHT = 12, TOP = 20, BOTTOM = 20;
function axes(pen, width, height, low, high, title, bottom) {
  pen.strokeStyle = colour('--line');
  pen.fillStyle = colour('--faint');
  pen.lineWidth = 1;
  const y = value => height - BOTTOM - (value - low) / (high - low) * (height - TOP - BOTTOM);
  const x = sample => LEFT + (sample - view.from) / (view.to - view.from) * (width - LEFT - RIGHT);
  pen.textAlign = 'right';
  pen.textBaseline = 'middle';
  for (const tick of ticks(low, high, 4)) {
    pen.beginPath(); pen.moveTo(LEFT, y(tick)); pen.lineTo(width - RIGHT, y(tick)); pen.stroke();
    pen.fillText(short(tick), LEFT - 6, y(tick));
  }
  pen.textAlign = 'center';
  pen.textBaseline = 'top';
  for (const tick of ticks(timeOf(view.from), timeOf(view.to), 8)) {
    const at = x(tick / data.period_s - data.first);
    pen.beginPath(); pen.moveTo(at, TOP); pen.lineTo(at, height - BOTTOM); pen.stroke();
    if (bottom) pen.fillText(short(tick) + ' s', at, height - BOTTOM + 4);
  }
  pen.textAlign = 'left';
  pen.fillStyle = colour('--ink');
  pen.fillText(title, LEFT, 3);
  return { x, y };
}

function drawCurve(pen, curve, x, y, width, ink) {
  pen.fillStyle = pen.strokeStyle = ink;
  pen.lineWidth = 1.3;
  const perPixel = (view.to - view.from) / (width - LEFT - RIGHT);
  if (perPixel > 0.7 * curve.width) {
    // Several samples a pixel: a bar from the least to the greatest, joined to its neighbours.
    let before = null;
    for (let pixel = LEFT; pixel < width - RIGHT; pixel++) {
      const a = view.from + (pixel - LEFT) * perPixel;
      const range = curve.range(a, a + perPixel);
      if (range) {
        let [low, high] = range;
        if (before) { low = Math.min(low, before[1]); high = Math.max(high, before[0]); }
        const top = y(high), bottom = y(low);
        pen.fillRect(pixel, top - 0.6, 1, Math.max(1.2, bottom - top + 1.2));
      }
      before = range;
    }
    return;
  }
  let open = false;
  const from = Math.max(0, Math.floor(view.from / curve.width) - 1);
  const to = Math.min((curve.levels[0].length >> 1) - 1, Math.ceil(view.to / curve.width) + 1);
  pen.save();
  const clip = new Path2D();
  clip.rect(LEFT, 0, width - LEFT - RIGHT, 1e5);
  pen.clip(clip);
  pen.beginPath();
  for (let i = from; i <= to; i++) {
    const low = curve.levels[0][2 * i], high = curve.levels[0][2 * i + 1];
    if (low > high) { open = false; continue; }
    const at = x((i + 0.5) * curve.width - 0.5);
    const ends = curve.width > 1 ? [curve.value(low), curve.value(high)] : [curve.value((low + high) / 2)];
    for (const value of ends) {
      if (open) pen.lineTo(at, y(value)); else pen.moveTo(at, y(value));
      open = true;
    }
  }
  pen.stroke();
  pen.restore();
}

const inks = ['--s0', '--s1', '--s2', '--s3', '--s4', '--s5', '--s6', '--s7', '--s8'];
const charts = byId('charts');
function addChart(list, title) {
  const canvas = document.createElement('canvas');
  canvas.setAttribute('role', 'img');
  canvas.setAttribute('aria-label', title + ' over time');
  charts.append(canvas);
  paint(canvas, (pen, width, height) => {
    let low = Infinity, high = -Infinity;
    for (const curve of list) {
      const range = curve.range(view.from, view.to);
      if (range) { low = Math.min(low, range[0]); high = Math.max(high, range[1]); }
    }
    if (low > high) { low = 0; high = 1; }
    const limit = list[0].limit;
    if (limit && Math.max(Math.abs(low), Math.abs(high)) > 0.3 * limit) {
      high = Math.max(high, limit);
      if (low < 0) low = Math.min(low, -limit);
    }
    // What stays the same needs a scale as well: what never moved that of its limit.
    if (low === 0 && high === 0) { high = limit || 1; low = -high; }
    const margin = 0.06 * (high - low) || Math.abs(high) * 0.1;
    low -= margin; high += margin;
    const words = limit ? `${title}, limit ${short(limit)}` : title;
    const { x, y } = axes(pen, width, height, low, high, words, true);
    pen.setLineDash([5, 4]);
    pen.strokeStyle = colour('--limit');
    for (const value of limit ? [limit, -limit] : []) {
      if (value < low || value > high) continue;
      pen.beginPath(); pen.moveTo(LEFT, y(value)); pen.lineTo(width - RIGHT, y(value)); pen.stroke();
    }
    pen.setLineDash([]);
    list.forEach((curve, n) => drawCurve(pen, curve, x, y, width, colour(inks[(curve.axis ?? n) % inks.length])));
    drawMark(pen, x, height);
  });
  listen(canvas);
}
function drawMark(pen, x, height) {
  if (marked === null || marked < view.from || marked > view.to) return;
  pen.strokeStyle = colour('--accent');
  pen.beginPath(); pen.moveTo(x(marked), TOP - 4); pen.lineTo(x(marked), height - BOTTOM); pen.stroke();
}

// --- the time line
const stateAt = sample => {
  let low = 0, high = data.states.length - 1;
  while (low < high) { const middle = (low + high + 1) >> 1; if (data.states[middle][0] - data.first <= sample) low = middle; else high = middle - 1; }
  return data.states.length ? data.states[low][1] : 0;
};
function addTimeLine() {
  const canvas = document.createElement('canvas');
  canvas.setAttribute('role', 'img');
  canvas.setAttribute('aria-label', 'states, holds, overrides and alarms over time');
  canvas.style.height = '118px';
  charts.append(canvas);
  const rows = { alarm: [2, 12], hold: [5, 6, 11], override: [4], program: [3, 10], timing: [7, 8, 9] };
  paint(canvas, (pen, width, height) => {
    const x = sample => LEFT + (sample - view.from) / (view.to - view.from) * (width - LEFT - RIGHT);
    pen.textBaseline = 'middle';
    pen.textAlign = 'right';
    pen.fillStyle = colour('--faint');
    pen.fillText('state', LEFT - 6, 14);
    data.states.forEach(([start, state], n) => {
      const from = start - data.first, to = n + 1 < data.states.length ? data.states[n + 1][0] - data.first : samples;
      if (to < view.from || from > view.to) return;
      const a = Math.max(LEFT, x(from)), b = Math.min(width - RIGHT, x(to));
      pen.fillStyle = colour(STATE_COLOURS[state] || '--line');
      pen.fillRect(a, 6, Math.max(1, b - a), 16);
      const word = STATES[state] || '?';
      if (b - a > pen.measureText(word).width + 9) {
        // What is not coloured is as light, or as dark, as the page.
        pen.fillStyle = colour(STATE_COLOURS[state] === '--line' ? '--ink' : '--paper');
        pen.textAlign = 'left';
        pen.fillText(word, a + 5, 14.5);
      }
    });
    Object.entries(rows).forEach(([name, kinds], row) => {
      const y = 34 + row * 16;
      pen.textAlign = 'right';
      pen.fillStyle = colour('--faint');
      pen.fillText(name, LEFT - 6, y);
      pen.strokeStyle = colour('--line');
      pen.beginPath(); pen.moveTo(LEFT, y); pen.lineTo(width - RIGHT, y); pen.stroke();
      pen.fillStyle = colour(name === 'alarm' ? '--bad' : name === 'timing' ? '--s1' : '--accent');
      for (const [sequence, kind] of data.events) {
        const sample = sequence - data.first;
        if (!kinds.includes(kind) || sample < view.from || sample > view.to) continue;
        pen.fillRect(x(sample) - 1, y - 6, name === 'alarm' ? 4 : 2.5, 12);
      }
    });
    for (const [start, count] of data.gaps) {
      const a = Math.max(LEFT, x(start - data.first)), b = Math.min(width - RIGHT, x(start - data.first + count));
      if (b > a) { pen.fillStyle = colour('--bad'); pen.globalAlpha = .25; pen.fillRect(a, 0, Math.max(2, b - a), height); pen.globalAlpha = 1; }
    }
    drawMark(pen, x, height);
  });
  listen(canvas);
}

// --- wheel, drag, hover on everything over time
function listen(canvas) {
  const sampleAt = event => {
    const box = canvas.getBoundingClientRect();
    const share = (event.clientX - box.left - LEFT) / (box.width - LEFT - RIGHT);
    return view.from + share * (view.to - view.from);
  };
  canvas.addEventListener('wheel', event => {
    event.preventDefault();
    const at = sampleAt(event), factor = Math.exp(Math.sign(event.deltaY) * 0.25);
    setView(at - (at - view.from) * factor, at + (view.to - at) * factor);
  }, { passive: false });
  let drag = null;
  canvas.addEventListener('pointerdown', event => { drag = { x: event.clientX, from: view.from, to: view.to }; canvas.setPointerCapture(event.pointerId); });
  canvas.addEventListener('pointerup', () => { drag = null; });
  canvas.addEventListener('pointermove', event => {
    if (drag) {
      const box = canvas.getBoundingClientRect();
      const by = (drag.x - event.clientX) / (box.width - LEFT - RIGHT) * (drag.to - drag.from);
      setView(drag.from + by, drag.to + by);
      return;
    }
    marked = Math.max(0, Math.min(samples - 1, Math.round(sampleAt(event))));
    const words = [`${seconds(timeOf(marked))} s`, `cycle ${data.first + marked}`, STATES[stateAt(marked)] || ''];
    const feed = curves[0].range(marked, marked);
    if (feed) words.push(`feed ${short(feed[1])} mm/s`);
    byId('readout').textContent = words.join(' · ');
    refreshAll();
  });
  canvas.addEventListener('dblclick', () => setView(0, samples));
}
byId('time-reset').onclick = () => setView(0, samples);
const zoom = factor => { const middle = (view.from + view.to) / 2, half = (view.to - view.from) / 2 * factor; setView(middle - half, middle + half); };
byId('zoom-in').onclick = () => zoom(0.5);
byId('zoom-out').onclick = () => zoom(2);

addTimeLine();
for (const curve of curves) {
  const name = curve.group === curve.label || !curve.label || ['feed', 'override', 'lateness', 'work', 'load'].includes(curve.group) ? curve.label : `${curve.label} ${curve.group}`;
  if (curve.group === 'override' && curve.least === 100 && curve.greatest === 100) continue;
  addChart([curve], `${name}, ${curve.unit}`);
}

// --- the path
const trail = {
  x: new Float32Array(bytes(data.trail.x)), y: new Float32Array(bytes(data.trail.y)), z: new Float32Array(bytes(data.trail.z)),
  feed: new Float32Array(bytes(data.trail.feed)), error: data.trail.error ? new Float32Array(bytes(data.trail.error)) : null,
  sequence: new Float64Array(bytes(data.trail.sequence)),
  rapid: new Uint8Array(bytes(data.trail.rapid)),
};
// The job of a served machine that is looked at: first and last cycle; all of them at first.
let job = null;
const inJob = sequence => !job || sequence >= job[2] && sequence <= job[3];
const canvas = byId('path-canvas');
const look = { view: 'xy', scale: 1, x: 0, y: 0, turn: -0.6, tilt: 1.0, by: 'feed' };
const SCALE = [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]];
const dark = matchMedia('(prefers-color-scheme: dark)');
const shade = share => {
  // The darkest tones cannot be seen on a dark page.
  if (dark.matches) share = .22 + .78 * share;
  const at = Math.max(0, Math.min(0.9999, share)) * (SCALE.length - 1), k = Math.floor(at);
  const mix = SCALE[k].map((value, n) => Math.round(value + (SCALE[k + 1][n] - value) * (at - k)));
  return `rgb(${mix})`;
};
const TONES = 24;
const spread = list => { let low = Infinity, high = -Infinity; for (const value of list) { if (value < low) low = value; if (value > high) high = value; } return [low, high]; };
const bounds = [spread(trail.x), spread(trail.y), spread(trail.z)];
const middle = bounds.map(([low, high]) => (low + high) / 2);
const size = Math.max(1e-6, ...bounds.map(([low, high]) => high - low));
function project(x, y, z) {
  x -= middle[0]; y -= middle[1]; z -= middle[2];
  if (look.view === 'xy') return [x, y];
  if (look.view === 'xz') return [x, z];
  if (look.view === 'yz') return [y, z];
  const c = Math.cos(look.turn), s = Math.sin(look.turn);
  const a = c * x - s * y, b = s * x + c * y;
  return [a, b * Math.cos(look.tilt) + z * Math.sin(look.tilt)];
}
paint(canvas, (pen, width, height) => {
  // What the job that is looked at has drawn: the trail is in order of time.
  let begin = 0, count = trail.x.length;
  if (job) {
    while (begin < count && trail.sequence[begin] < job[2]) begin++;
    // The point before is where it begins.
    begin = Math.max(0, begin - 1);
    let end = begin;
    while (end < count && trail.sequence[end] <= job[3]) end++;
    count = Math.max(begin, end);
  }
  if (count - begin < 2) { pen.fillStyle = colour('--faint'); pen.fillText('nothing moved', 20, 30); return; }
  const flat = new Float32Array(2 * count);
  let left = Infinity, right = -Infinity, low = Infinity, high = -Infinity;
  for (let i = begin; i < count; i++) {
    const [a, b] = project(trail.x[i], trail.y[i], trail.z[i]);
    flat[2 * i] = a; flat[2 * i + 1] = b;
    if (a < left) left = a; if (a > right) right = a; if (b < low) low = b; if (b > high) high = b;
  }
  // In space the tripod belongs to the picture.
  const tripod = [];
  if (look.view === '3d') {
    const corner = [bounds[0][0], bounds[1][0], bounds[2][0]];
    const from = project(...corner);
    ['X', 'Y', 'Z'].forEach((name, n) => {
      const end = corner.slice();
      end[n] += Math.max(bounds[n][1] - bounds[n][0], size / 8);
      tripod.push([name, n, end[n], from, project(...end)]);
    });
    if (!job) for (const [, , , from, to] of tripod) for (const [a, b] of [from, to]) {
      left = Math.min(left, a); right = Math.max(right, a); low = Math.min(low, b); high = Math.max(high, b);
    }
  }
  const wide = Math.max(right - left, 1e-9), tall = Math.max(high - low, 1e-9);
  const fit = Math.min((width - 120) / wide, (height - 84) / tall);
  const scale = fit * look.scale;
  const cx = width / 2 + look.x - scale * (left + right) / 2;
  const cy = height / 2 + 8 + look.y + scale * (low + high) / 2;
  look.fit = scale;
  // A text about here, within the picture.
  const label = (text, x, y) => {
    const half = pen.measureText(text).width / 2 + 3;
    pen.fillText(text, Math.max(half, Math.min(width - half, x)), Math.max(9, Math.min(height - 9, y)));
  };
  const X = i => cx + scale * flat[2 * i], Y = i => cy - scale * flat[2 * i + 1];
  // Scales along the edges of a plane, a tripod in space.
  pen.fillStyle = colour('--faint'); pen.strokeStyle = colour('--line'); pen.lineWidth = 1;
  if (look.view !== '3d') {
    const [h, v] = look.view === 'xy' ? [0, 1] : look.view === 'xz' ? [0, 2] : [1, 2];
    pen.textBaseline = 'bottom'; pen.textAlign = 'center';
    for (const tick of ticks((0 - cx) / scale + middle[h], (width - cx) / scale + middle[h], 9)) {
      const at = cx + scale * (tick - middle[h]);
      pen.beginPath(); pen.moveTo(at, 0); pen.lineTo(at, height); pen.stroke();
      const half = pen.measureText(short(tick)).width / 2;
      if (at > half + 2 && at < width - half - 46) pen.fillText(short(tick), at, height - 4);
    }
    pen.textBaseline = 'middle'; pen.textAlign = 'left';
    for (const tick of ticks((cy - height) / scale + middle[v], cy / scale + middle[v], 6)) {
      const at = cy - scale * (tick - middle[v]);
      pen.beginPath(); pen.moveTo(0, at); pen.lineTo(width, at); pen.stroke();
      // The corners are for the names of the axes.
      if (at > 34 && at < height - 22) pen.fillText(short(tick), 6, at - 7);
    }
    pen.fillStyle = colour('--ink');
    pen.textAlign = 'right'; pen.textBaseline = 'bottom';
    pen.fillText(look.view[0].toUpperCase() + ', mm', width - 6, height - 4);
    pen.textAlign = 'left'; pen.textBaseline = 'top';
    pen.fillText(look.view[1].toUpperCase() + ', mm', 6, 4);
  } else {
    tripod.forEach(([name, n, value, [ox, oy], [ex, ey]]) => {
      pen.strokeStyle = colour(inks[n]); pen.fillStyle = colour(inks[n]);
      pen.beginPath(); pen.moveTo(cx + scale * ox, cy - scale * oy); pen.lineTo(cx + scale * ex, cy - scale * ey); pen.stroke();
      pen.textAlign = 'center'; pen.textBaseline = 'middle';
      label(`${name} ${short(value)}`, cx + scale * ex + 10, cy - scale * ey - 8);
    });
  }
  const values = look.by === 'error' && trail.error ? trail.error : trail.feed;
  // Rapids are many times as fast as a cut: they have a look of their own and no part in the scale.
  const hasCuts = data.fastest_cut > 0;
  let cut = 0;
  if (job) for (let i = begin + 1; i < count; i++) if (!trail.rapid[i]) cut = Math.max(cut, trail.feed[i]);
  const most = look.by === 'error' ? data.max_error || 1 : cut || (hasCuts ? data.fastest_cut : Math.max(curves[0].greatest, 1e-9));
  const paths = Array.from({ length: TONES }, () => new Path2D()), rapids = new Path2D();
  let drawn = -1;
  for (let i = begin + 1; i < count; i++) {
    if (trail.rapid[i] && look.by === 'feed' && hasCuts) {
      // In one stroke, so that the dashes go on.
      if (drawn !== i - 1) rapids.moveTo(X(i - 1), Y(i - 1));
      rapids.lineTo(X(i), Y(i));
      drawn = i;
      continue;
    }
    const value = (values[i] + values[i - 1]) / 2;
    const tone = Math.max(0, Math.min(TONES - 1, Math.floor(value / most * TONES))) || 0;
    paths[tone].moveTo(X(i - 1), Y(i - 1));
    paths[tone].lineTo(X(i), Y(i));
  }
  pen.lineWidth = 1;
  pen.strokeStyle = colour('--s7');
  pen.setLineDash([4, 3]);
  pen.stroke(rapids);
  pen.setLineDash([]);
  pen.lineWidth = 1.6;
  pen.lineCap = 'round';
  paths.forEach((path, tone) => { pen.strokeStyle = shade((tone + 0.5) / TONES); pen.stroke(path); });
  // Start and end, with their names where these do not lie on each other.
  const [sx, sy, ex, ey] = [X(begin), Y(begin), X(count - 1), Y(count - 1)];
  const isSame = Math.hypot(ex - sx, ey - sy) < 26;
  pen.lineWidth = 1.8; pen.textBaseline = 'middle'; pen.textAlign = 'center';
  pen.fillStyle = colour('--paper'); pen.strokeStyle = colour('--good');
  pen.beginPath(); pen.arc(sx, sy, 5, 0, 7); pen.fill(); pen.stroke();
  pen.strokeStyle = colour('--bad');
  pen.beginPath(); pen.rect(ex - 3, ey - 3, 6, 6); pen.fill(); pen.stroke();
  for (const [text, x, y] of isSame ? [['start, end', sx, sy]] : [['start', sx, sy], ['end', ex, ey]]) {
    // On paper of their own: they lie on the path.
    const half = pen.measureText(text).width / 2 + 3;
    const at = Math.max(half, Math.min(width - half, x)), up = y > 30 ? y - 15 : y + 15;
    pen.globalAlpha = .8; pen.fillStyle = colour('--paper'); pen.fillRect(at - half, up - 8, 2 * half, 16);
    pen.globalAlpha = 1; pen.fillStyle = colour('--ink'); label(text, x, up);
  }
  if (marked !== null) {
    let low = begin, high = count - 1;
    while (low < high) { const middle = (low + high) >> 1; if (trail.sequence[middle] < data.first + marked) low = middle + 1; else high = middle; }
    pen.strokeStyle = colour('--ink'); pen.lineWidth = 2;
    pen.beginPath(); pen.arc(X(low), Y(low), 5, 0, 7); pen.stroke();
  }
  const unit = look.by === 'error' ? 'mm of following error' : 'mm/s';
  const dashed = look.by === 'feed' && hasCuts ? '; rapids, jogs and homing dashed grey' : '';
  byId('path-legend').textContent = `from dark (0) to bright (${short(most)} ${unit})${dashed}; circle: start, square: end; ${count - begin} points show ${job ? job[3] - job[2] + 1 : data.cycles} cycles`;
  const bar = 140;
  for (let i = 0; i < bar; i++) { pen.fillStyle = shade(i / bar); pen.fillRect(width - bar - 14 + i, 10, 1.5, 9); }
  pen.fillStyle = colour('--faint'); pen.textBaseline = 'top';
  pen.textAlign = 'left'; pen.fillText('0', width - bar - 14, 22);
  pen.textAlign = 'right'; pen.fillText(`${short(most)} ${look.by === 'error' ? 'mm' : 'mm/s'}`, width - 12, 22);
});
{
  let drag = null;
  canvas.addEventListener('wheel', event => {
    event.preventDefault();
    const box = canvas.getBoundingClientRect();
    const factor = Math.exp(-Math.sign(event.deltaY) * 0.2), dx = event.clientX - box.left - box.width / 2, dy = event.clientY - box.top - box.height / 2;
    look.x = dx - (dx - look.x) * factor; look.y = dy - (dy - look.y) * factor; look.scale *= factor;
    refreshAll();
  }, { passive: false });
  canvas.addEventListener('pointerdown', event => { drag = { x: event.clientX, y: event.clientY, look: { ...look } }; canvas.setPointerCapture(event.pointerId); });
  canvas.addEventListener('pointerup', () => { drag = null; });
  canvas.addEventListener('pointermove', event => {
    if (!drag) return;
    const dx = event.clientX - drag.x, dy = event.clientY - drag.y;
    if (look.view === '3d' && !event.shiftKey) {
      look.turn = drag.look.turn + dx * 0.008;
      look.tilt = Math.max(0, Math.min(Math.PI / 2, drag.look.tilt - dy * 0.008));
    } else {
      look.x = drag.look.x + dx;
      look.y = drag.look.y + dy;
    }
    refreshAll();
  });
}
let shownTable = 'slowest';
const resetPath = () => { look.scale = 1; look.x = look.y = 0; refreshAll(); };
byId('path-reset').onclick = resetPath;
const setPathView = name => {
  look.view = name;
  document.querySelectorAll('[data-view]').forEach(other => other.classList.toggle('on', other.dataset.view === name));
  resetPath();
};
document.querySelectorAll('[data-view]').forEach(button => { button.onclick = () => setPathView(button.dataset.view); });
if (data.jobs.length) {
  data.jobs.forEach(([number, name], n) => {
    const option = document.createElement('option');
    option.value = n;
    option.textContent = `${number}: ${name}`;
    byId('job').append(option);
  });
} else byId('job-choice').hidden = true;
const setJob = n => {
  job = n === '' ? null : data.jobs[n];
  byId('job').value = n;
  if (job) setView(job[2] - data.first, job[3] - data.first + 1); else setView(0, samples);
  resetPath();
  table(shownTable);
};
byId('job').onchange = event => setJob(event.target.value);
byId('colour').onchange = event => { look.by = event.target.value; refreshAll(); };
if (!trail.error) {
  const option = byId('colour').querySelector('[value=error]');
  option.disabled = true;
  option.textContent = 'following error (none was recorded)';
}
// A path that is upright is best seen so.
if (bounds[1][1] - bounds[1][0] < 1e-9 && bounds[2][1] - bounds[2][0] > 1e-9) setPathView('xz');

// --- histograms: both scales logarithmic
function histogram(id, bars, title) {
  paint(byId(id), (pen, width, height) => {
    pen.fillStyle = colour('--ink'); pen.textBaseline = 'top'; pen.textAlign = 'left';
    const list = bars.bars;
    if (!data.realtime || !list.length) { pen.fillText(`${title}: not measured with the virtual clock`, LEFT, 4); return; }
    pen.fillText(`${title}: ${bars.total} cycles, at most ${short(bars.max_ns / 1000)} us`, LEFT, 4);
    const first = Math.floor(list[0][0] / 10) * 10, last = Math.ceil((list[list.length - 1][0] + 1) / 10) * 10;
    const most = Math.max(...list.map(bar => bar[1]), 10), top = Math.ceil(Math.log10(most));
    const x = bar => LEFT + (bar - first) / (last - first) * (width - LEFT - RIGHT);
    const y = count => height - BOTTOM - (Math.log10(count) + 0.15) / (top + 0.15) * (height - TOP - BOTTOM - 4);
    pen.strokeStyle = colour('--line'); pen.fillStyle = colour('--faint');
    pen.textAlign = 'right'; pen.textBaseline = 'middle';
    for (let power = 0; power <= top; power++) {
      pen.beginPath(); pen.moveTo(LEFT, y(10 ** power)); pen.lineTo(width - RIGHT, y(10 ** power)); pen.stroke();
      pen.fillText((10 ** power).toLocaleString('en'), LEFT - 6, y(10 ** power));
    }
    pen.textAlign = 'center'; pen.textBaseline = 'top';
    const NAMES = ['1 ns', '10 ns', '100 ns', '1 us', '10 us', '100 us', '1 ms', '10 ms', '100 ms', '1 s', '10 s', '100 s'];
    for (let bar = first; bar <= last; bar += 10) pen.fillText(NAMES[bar / 10] || '', Math.min(x(bar), width - 20), height - BOTTOM + 4);
    pen.fillStyle = colour('--s0');
    for (const [bar, count] of list) pen.fillRect(x(bar) + .5, y(count), Math.max(1, x(bar + 1) - x(bar) - 1), height - BOTTOM - y(count));
  });
}
if (!data.realtime) byId('histograms').hidden = true;
histogram('lateness-canvas', data.lateness, 'woken late');
histogram('work-canvas', data.work, 'own work of a cycle');

// --- tables and program
const texts = new Map(data.program.lines);
const jobNames = new Map(data.jobs.map(([number, name]) => [number, `${number}: ${name}`]));
const cell = (row, text, name) => { const td = document.createElement('td'); if (name) td.className = name; td.append(text); row.append(td); return td; };
function table(name) {
  shownTable = name;
  const head = byId('lines').tHead, body = byId('lines').tBodies[0];
  const isSession = data.jobs.length > 0;
  head.innerHTML = '<tr>' + (isSession ? '<th class="text">job</th>' : '') + '<th>line</th><th class="text">text</th><th>time, s</th><th>share</th><th>planned, s</th><th>at a limit, s</th><th>held, s</th><th>path, mm</th><th>mean, mm/s</th><th>greatest</th><th class="text">what set the pace</th></tr>';
  body.textContent = '';
  const whole = (job ? job[3] - job[2] + 1 : data.cycles) * data.period_s;
  for (const line of data[name].filter(line => !job || line.job === job[0]).slice(0, 40)) {
    const row = document.createElement('tr');
    if (isSession) cell(row, jobNames.get(line.job) || '', 'text');
    const link = document.createElement('a');
    // Without the program's text there is still where it was in time.
    link.href = texts.has(line.line) ? `#line-${line.line}` : '#time';
    link.textContent = line.line;
    link.onclick = () => { setView(line.start - data.first - 50, line.start - data.first + line.time / data.period_s + 50); hit(line.line); };
    cell(row, link);
    cell(row, texts.get(line.line) || line.text || '', 'text code');
    cell(row, line.time.toFixed(3));
    cell(row, (100 * line.time / whole).toFixed(1) + ' %');
    cell(row, line.planned == null ? '' : line.planned.toFixed(3));
    cell(row, line.limited.toFixed(3));
    cell(row, line.held ? line.held.toFixed(3) : '');
    cell(row, line.path.toFixed(2));
    cell(row, short(line.mean));
    cell(row, short(line.max));
    cell(row, line.limits, 'text');
    body.append(row);
  }
  document.querySelectorAll('[data-table]').forEach(button => button.classList.toggle('on', button.dataset.table === name));
}
document.querySelectorAll('[data-table]').forEach(button => { button.onclick = () => table(button.dataset.table); });
table('slowest');
const listing = byId('program'), longest = data.slowest.length ? data.slowest[0].time : 1;
const timeOfLine = new Map([...data.slowest, ...data.limited].map(line => [line.line, line.time]));
let previous = 0;
for (const [number, text] of data.program.lines) {
  if (number > previous + 1) { const cut = document.createElement('li'); cut.className = 'cut'; cut.textContent = `… ${number - previous - 1} lines`; listing.append(cut); }
  previous = number;
  const item = document.createElement('li');
  item.id = `line-${number}`;
  const label = document.createElement('span');
  label.className = 'number';
  label.textContent = number;
  const code = document.createElement('span');
  code.textContent = text;
  item.append(label, code);
  const time = timeOfLine.get(number);
  if (time) { const bar = document.createElement('span'); bar.className = 'bar'; bar.style.width = `${Math.max(2, 160 * time / longest)}px`; bar.title = `${time.toFixed(3)} s`; item.append(bar); }
  listing.append(item);
}
if (data.program.count > previous && !data.program.whole) { const cut = document.createElement('li'); cut.className = 'cut'; cut.textContent = `… ${data.program.count - previous} lines`; listing.append(cut); }
if (!data.program.count) byId('listing').hidden = true;
function hit(number) {
  document.querySelectorAll('#program .hit').forEach(item => item.classList.remove('hit'));
  const item = byId(`line-${number}`);
  if (item) item.classList.add('hit');
}
const eventBody = byId('event-table').tBodies[0];
for (const [sequence, kind, code, text] of data.events.slice(0, 1000)) {
  const row = document.createElement('tr');
  const link = document.createElement('a');
  link.href = '#time';
  link.textContent = seconds(sequence * data.period_s);
  link.onclick = () => { marked = sequence - data.first; setView(marked - 1 / data.period_s, marked + 1 / data.period_s); };
  cell(row, link);
  cell(row, KINDS[kind] || 'of a later version', 'text');
  cell(row, String(code));
  cell(row, text, 'text');
  eventBody.append(row);
}
const leftOut = data.events_left_out + Math.max(0, data.events.length - 1000);
if (leftOut) { const row = document.createElement('tr'); cell(row, ''); cell(row, ''); cell(row, ''); cell(row, `${leftOut} more are in the trace`, 'text'); eventBody.append(row); }
if (!data.events.length) byId('events').hidden = true;

window.addEventListener('resize', refreshAll);
matchMedia('(prefers-color-scheme: dark)').addEventListener('change', refreshAll);
window.addEventListener('beforeprint', () => { document.documentElement.classList.add('print'); refreshNow(); });
window.addEventListener('afterprint', () => { document.documentElement.classList.remove('print'); refreshNow(); });
const wish = new URLSearchParams(location.hash.slice(1));
if (wish.get('view')) setPathView(wish.get('view'));
if (wish.get('job')) setJob(String(data.jobs.findIndex(([number]) => number === +wish.get('job'))));
if (wish.get('table')) table(wish.get('table'));
if (wish.get('from')) setView(+wish.get('from') / data.period_s - data.first, +wish.get('to') / data.period_s - data.first);
refreshNow();
// What a test may ask for: what a curve shows of a stretch of samples.
window.evolvent = { data, curves, view, setView, samples, trail, setJob, refreshNow };
document.documentElement.dataset.ready = 'yes';
})();
