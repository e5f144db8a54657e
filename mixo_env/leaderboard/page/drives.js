"use strict";
// One drive: paths of chosen methods, weights over time, when cameras were lost. Last: the page begins here.
const chosen = new Set();
const scene = () => DATA.drives.scenes[Number(byId("scene").value)];
const way = (name) => DATA.drives.tracks[shown.track][name]?.scenes[Number(byId("scene").value)];

function fillDrives() {
  const scenes = DATA.drives.scenes;
  const before = byId("scene").value;
  options(byId("scene"), scenes.map((one) => `${one.name} (${one.condition}, turns ${one.turned_deg} deg, ${one.log})`), scenes.map((_, i) => i));
  // A straight drive shows little: the most winding one comes first to the eye.
  byId("scene").value = before || scenes.reduce((best, one, i) => (one.turned_deg > scenes[best].turned_deg ? i : best), 0);
  const rows = DATA.drives.tracks[shown.track];
  const names = Object.keys(rows);
  if (![...chosen].some((name) => names.includes(name))) {
    drawnRows(6).filter((row) => names.includes(row.policy)).slice(0, 4).forEach((row) => chosen.add(row.policy));
  }
  byId("methods").replaceChildren(...names.map((name) => {
    const box = element("input", undefined, { type: "checkbox", value: name });
    box.checked = chosen.has(name);
    box.addEventListener("change", () => {
      if (box.checked) chosen.add(name);
      else chosen.delete(name);
      drawDrive();
    });
    const made = element("label");
    made.append(box, element("span", name));
    return made;
  }));
  const weighing = names.filter((name) => rows[name].scenes.some((one) => one?.weights));
  options(byId("weigher"), weighing);
  if (weighing.includes("MIXO")) byId("weigher").value = "MIXO";
  const left = DATA.drives.left_out;
  byId("thinned").textContent =
    (left ? `${left} further scenes are not on this page. ` : "") +
    "Paths are thinned; every pose stands in trajectories.zip beside this page (TUM files).";
}

function drawPath() {
  const truth = scene();
  const metres = (values, errors) => values.map((value, i) => (value + (errors ? errors[i] : 0)) / 100);
  const traces = [{
    name: "truth", x: metres(truth.x_cm), y: metres(truth.y_cm), type: "scatter", mode: "lines",
    line: { color: "rgba(0,0,0,.35)", width: 6 }, text: truth.time_s.map((time) => `truth, ${time} s`), hoverinfo: "text",
  }];
  for (const name of chosen) {
    const own = way(name);
    if (!own) continue;
    const look = style(name);
    traces.push({
      name: label(name), x: metres(truth.x_cm, own.dx_cm), y: metres(truth.y_cm, own.dy_cm), type: "scatter",
      mode: "lines+markers", line: { color: look.color, dash: look.dash }, marker: { symbol: look.symbol, size: 5 },
      text: own.dx_cm.map((dx, i) =>
        `${label(name)}, ${truth.time_s[i]} s<br>${(Math.hypot(dx, own.dy_cm[i]) / 100).toFixed(2)} m from the truth`),
      hoverinfo: "text",
    });
  }
  Plotly.react("path", traces, layout({
    height: 460, xaxis: axis("east, m"), yaxis: axis("north, m", { scaleanchor: "x", scaleratio: 1 }),
  }), PLAIN);
}

function drawWeights() {
  const name = byId("weigher").value;
  const weights = name && way(name)?.weights;
  const experts = name ? DATA.drives.tracks[shown.track][name].experts : [];
  const traces = weights ? experts.map((expert, i) => ({
    name: label(expert), x: scene().time_s, y: weights[i].map((value) => value / 100), type: "scatter",
    mode: "lines+markers", line: { color: COLOURS[i % COLOURS.length], dash: DASHES[i % DASHES.length] },
    marker: { symbol: SYMBOLS[i % SYMBOLS.length], size: 5 },
    text: weights[i].map((value, k) => `${label(expert)}, ${scene().time_s[k]} s: ${(value / 100).toFixed(2)}`),
    hoverinfo: "text",
  })) : [];
  Plotly.react("weights", traces, layout({
    height: 320, xaxis: axis("time, s"), yaxis: axis(name ? `weights of ${label(name)}` : "no row has weights"),
  }), PLAIN);
}

function drawLost() {
  const cameras = Object.keys(scene().lost);
  const traces = cameras.map((camera, lane) => {
    const at = scene().lost[camera];
    return {
      name: label(camera), x: at.map((i) => scene().time_s[i]), y: at.map(() => lane), type: "scatter", mode: "markers",
      marker: { symbol: "x", size: 9, color: "#a30000" }, showlegend: false, hoverinfo: "text",
      text: at.map((i) => `${label(camera)} lost, ${scene().time_s[i]} s`),
    };
  });
  const times = scene().time_s;
  Plotly.react("lost", traces, layout({
    height: 110 + 26 * cameras.length, xaxis: axis("time, s", { range: [times[0], times[times.length - 1]] }),
    yaxis: axis("", { tickvals: cameras.map((_, i) => i), ticktext: cameras.map((camera) => `${label(camera)} lost`),
      range: [cameras.length - 0.5, -0.5], title: undefined }),
  }), PLAIN);
}

function drawDrive() {
  if (!DATA.drives.scenes.length) return;
  drawPath();
  drawWeights();
  drawLost();
}

function drawRows() {
  drawTable();
  drawIntervals();
  drawLengths();
}

function drawTrack() {
  fillGroups();
  drawRows();
  drawAnatomy();
  drawMade();
  fillDrives();
  drawDrive();
}

options(byId("track"), Object.keys(DATA.tracks));
byId("track").addEventListener("change", (event) => { shown.track = event.target.value; drawTrack(); });
byId("group").addEventListener("change", (event) => { shown.group = Number(event.target.value); drawRows(); });
byId("search").addEventListener("input", (event) => { shown.search = event.target.value; drawRows(); });
for (const id of ["scene", "weigher"]) byId(id).addEventListener("change", drawDrive);
drawFailures();
drawTrack();
document.body.dataset.ready = "yes";
