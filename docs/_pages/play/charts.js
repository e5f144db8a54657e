"use strict";
// Two drawings on canvas: paths from above, and claims over time. Lines differ in dash and end in their name.
const COLOURS = ["#0072b2", "#c25700", "#007a5a", "#a83c80", "#6b5b00", "#444444"];
const DASHES = [[], [8, 3], [2, 3], [9, 3, 2, 3], [14, 4], [4, 4]];
const LOOKS = { // of rows
  you: { colour: "#c40000", dash: [], width: 2.6 },
  rows: [["#00558c", [7, 4]], ["#6a3d9a", [2, 3]], ["#00704f", [10, 3, 2, 3]]],
};
const rowLook = (i) => ({ colour: LOOKS.rows[i % 3][0], dash: LOOKS.rows[i % 3][1], width: 1.8 });
const short = (name) => name.replace("CAM_", "").replaceAll("_", " ").toLowerCase();

function prepared(canvas) {
  const ratio = window.devicePixelRatio || 1;
  const { clientWidth: width, clientHeight: height } = canvas;
  canvas.width = Math.round(width * ratio);
  canvas.height = Math.round(height * ratio);
  const pen = canvas.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, width, height);
  pen.font = "12px system-ui, sans-serif";
  pen.lineJoin = "round";
  return { pen, width, height };
}

function line(pen, points, look) {
  pen.strokeStyle = look.colour;
  pen.lineWidth = look.width;
  pen.setLineDash(look.dash);
  pen.beginPath();
  let down = false;
  for (const point of points) {
    if (point === null) { down = false; continue; }
    if (down) pen.lineTo(point[0], point[1]);
    else pen.moveTo(point[0], point[1]);
    down = true;
  }
  pen.stroke();
  pen.setLineDash([]);
}

function write(pen, text, x, y, colour = "#1a1a1a", align = "left") {
  pen.fillStyle = colour;
  pen.textAlign = align;
  pen.fillText(text, x, y);
}

// A sample of every line beside its name, row after row.
function legend(pen, entries, x, y, width) {
  let at = x, row = y;
  for (const [name, look] of entries) {
    const wide = 30 + pen.measureText(name).width + 14;
    if (at > x && at + wide > width) { at = x; row += 17; }
    line(pen, [[at, row - 4], [at + 24, row - 4]], look);
    write(pen, name, at + 29, row);
    at += wide;
  }
  return row;
}

function niceStep(span, count) {
  const rough = span / count, power = 10 ** Math.floor(Math.log10(rough));
  return [1, 2, 5, 10].find((factor) => factor * power >= rough) * power;
}

const whole = { x: [0, ...DRIVE.truth.x_m], y: [0, ...DRIVE.truth.y_m] }; // the true path, start included

function drawPaths(canvas, rows, magnify) {
  const { pen, width, height } = prepared(canvas);
  const k = rows[0].estimate.step;
  const entries = [["truth", { colour: "#999", dash: [], width: 7 }], ...rows.map((row) => [row.name, row.look])];
  const top = legend(pen, entries, 10, 18, width) + 30; // room for those who drift ahead
  const [left, right] = [Math.min(...whole.x), Math.max(...whole.x)];
  const [low, high] = [Math.min(...whole.y), Math.max(...whole.y)];
  const scale = Math.min((width - 60) / Math.max(right - left, 10), (height - top - 50) / Math.max(high - low, 10));
  const place = (x, y) => [width / 2 + (x - (left + right) / 2) * scale, top + (height - top - 20) / 2 - (y - (low + high) / 2) * scale];
  line(pen, whole.x.map((x, i) => place(x, whole.y[i])), { colour: "#bbb", dash: [], width: 1.5 }); // the road ahead
  line(pen, whole.x.slice(0, k + 1).map((x, i) => place(x, whole.y[i])), { colour: "#999", dash: [], width: 7 });
  for (const { estimate, look } of [...rows].reverse()) {
    const points = [];
    for (let i = 0; i <= k; i++) {
      points.push(place(whole.x[i] + magnify * (estimate.x[i] - whole.x[i]), whole.y[i] + magnify * (estimate.y[i] - whole.y[i])));
    }
    line(pen, points, look);
    pen.fillStyle = look.colour;
    pen.beginPath();
    pen.arc(...points[k], 4, 0, 7);
    pen.fill();
  }
  pen.clearRect(0, 0, width, top - 22);
  legend(pen, entries, 10, 18, width);
  const bar = niceStep((right - left) || 10, 5);
  line(pen, [[12, height - 12], [12 + bar * scale, height - 12]], { colour: "#1a1a1a", dash: [], width: 2 });
  write(pen, `${bar} m`, 18 + bar * scale, height - 8);
}

const times = DRIVE.dt_s.reduce((all, dt) => [...all, all[all.length - 1] + dt], [0]);
const rates = (increments) => increments.map((value, i) => (value === null ? null : (value / DRIVE.dt_s[i]) * DEGREES));
const claimed = DRIVE.experts.map((_, j) => rates(DRIVE.claims_rad.map((step) => step[j])));
const trueRates = rates(DRIVE.truth.increment_rad);

// Most of the values lie within: a wild claim leaves the drawing, not the scale.
function bounds(series, share) {
  const values = series.flat().filter((value) => value !== null).sort((a, b) => a - b);
  const at = (part) => values[Math.round(part * (values.length - 1))] ?? 0;
  const [low, high] = [Math.min(at(1 - share), 0), Math.max(at(share), 0)];
  const room = 0.15 * (high - low) || 1;
  return [low - room, high + room];
}

function drawClaims(canvas, step, minusTruth) {
  const { pen, width, height } = prepared(canvas);
  const looks = DRIVE.experts.map((_, j) => ({ colour: COLOURS[j % 6], dash: DASHES[j % 6], width: 1.7 }));
  const entries = DRIVE.experts.map((name, j) => [short(name), looks[j]]);
  if (!minusTruth) entries.unshift(["truth", { colour: "#bbb", dash: [], width: 6 }]);
  const top = legend(pen, entries, 10, 18, width) + 26;
  const lanes = 14 * DRIVE.experts.length + 8;
  const box = { left: 72, right: width - 10, top, bottom: height - 34 - lanes };
  const shown = claimed.map((series) => series.map((v, i) => (v === null || !minusTruth ? v : v - trueRates[i])));
  const [low, high] = minusTruth ? bounds(shown, 0.98) : bounds([...shown, trueRates], 0.999);
  const across = (time) => box.left + ((box.right - box.left) * time) / times[STEPS];
  const up = (value) => box.bottom - ((box.bottom - box.top) * (value - low)) / (high - low);
  drawGrid(pen, box, low, high, across, up, height);
  write(pen, minusTruth ? "claim minus truth, deg/s" : "yaw rate, deg/s", box.left, box.top - 6, "#555");
  pen.save();
  pen.beginPath();
  pen.rect(box.left, box.top, box.right - box.left, box.bottom - box.top);
  pen.clip();
  const points = (series, stop) => series.slice(0, stop).map((v, i) => (v === null ? null : [across(times[i + 1]), up(v)]));
  if (!minusTruth) line(pen, points(trueRates, step), { colour: "#bbb", dash: [], width: 6 });
  // The claims of the step to be decided are known; its truth is not.
  shown.forEach((series, j) => line(pen, points(series, minusTruth ? step : step + 1), looks[j]));
  pen.restore();
  drawLost(pen, looks, box, across, step);
}

function drawGrid(pen, box, low, high, across, up, height) {
  const faint = { colour: "#ddd", dash: [], width: 1 };
  const spacing = niceStep(high - low, 6), digits = Math.max(0, -Math.floor(Math.log10(spacing)));
  for (let value = Math.ceil(low / spacing) * spacing; value <= high; value += spacing) {
    line(pen, [[box.left, up(value)], [box.right, up(value)]], faint);
    write(pen, (Math.round(value / spacing) * spacing).toFixed(digits), box.left - 5, up(value) + 4, "#555", "right");
  }
  for (let time = 0; time <= times[STEPS]; time += 5) {
    line(pen, [[across(time), box.top], [across(time), box.bottom]], faint);
    write(pen, `${time} s`, across(time), height - 6, "#555", time ? "center" : "left");
  }
}

// One lane an expert: a cross where it is lost, a dot where it starts up or got no picture.
function drawLost(pen, looks, box, across, step) {
  DRIVE.experts.forEach((name, j) => {
    const y = box.bottom + 16 + 14 * j;
    write(pen, short(name).slice(0, 11), box.left - 5, y, "#555", "right");
    line(pen, [[box.left, y - 4], [box.right, y - 4]], { colour: "#eee", dash: [], width: 1 });
    [...(DRIVE.states[name] ?? "")].slice(0, step + 1).forEach((letter, i) => {
      if (letter === "t") return;
      write(pen, letter === "l" ? "✕" : "·", across(times[i + 1]), y, looks[j].colour, "center");
    });
  });
}
