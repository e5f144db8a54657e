"use strict";
// Pictures of the chosen rows. A row keeps its colour, symbol and dashes in all of them.
const COLOURS = ["#0072B2", "#D55E00", "#007A5A", "#7A4FB5", "#222222", "#B5477F", "#8C564B", "#9A6700", "#1B6CA8", "#666600"];
const DASHES = ["solid", "dash", "dot", "dashdot", "longdash", "longdashdot"];
const SYMBOLS = ["circle", "square", "diamond", "triangle-up", "x", "cross", "triangle-down", "star"];
const PLAIN = { displayModeBar: false, responsive: true };

// The library reads a little HTML in labels: names are shown as they are.
const label = (name) => String(name).replace(/&/g, "&amp;").replace(/</g, "&lt;").replace(/>/g, "&gt;");

function style(name) {
  const names = [...new Set(groups().flatMap((one) => one.rows.map((row) => row.policy)))];
  const i = Math.max(0, names.indexOf(name));
  return { color: COLOURS[i % COLOURS.length], dash: DASHES[i % DASHES.length], symbol: SYMBOLS[i % SYMBOLS.length] };
}

function layout(more) {
  const narrow = window.innerWidth < 600;
  const font = { family: "system-ui, Arial, sans-serif", size: 13, color: "#1a1a1a" };
  const legend = { orientation: "h", yref: "container", y: 0, yanchor: "bottom" };
  const margin = { l: narrow ? 48 : 64, r: 12, t: 12, b: 48 };
  return { font, margin, legend, hovermode: "closest", paper_bgcolor: "#fff", plot_bgcolor: "#fff", ...more };
}

const axis = (title, more = {}) => ({ title: { text: title }, gridcolor: "#e4e4e4", zerolinecolor: "#999", automargin: true, ...more });

function drawIntervals() {
  const rows = found().filter((row) => row.rotation_deg_per_m.mean !== null).reverse();
  const value = rows.map((row) => row.rotation_deg_per_m);
  const narrow = window.innerWidth < 600;
  const names = rows.map((row) => label(narrow && row.policy.length > 16 ? row.policy.slice(0, 15) + "…" : rowName(row)));
  const places = rows.map((_, i) => i);
  const trace = {
    x: value.map((one) => one.mean), y: places, mode: "markers", type: "scatter", showlegend: false,
    marker: { color: rows.map((row) => (row.privileged ? "#777" : "#00558c")), size: 8,
      symbol: rows.map((row) => (row.privileged ? "circle-open" : "circle")) },
    error_x: { type: "data", symmetric: false, array: value.map((one) => (one.high ?? one.mean) - one.mean),
      arrayminus: value.map((one) => one.mean - (one.low ?? one.mean)), color: "#555", thickness: 1.4 },
    text: rows.map((row) => `${label(rowName(row))}<br>${interval(row.rotation_deg_per_m, 4)} deg/m`), hoverinfo: "text",
  };
  Plotly.react("intervals", [trace], layout({
    height: Math.max(220, 70 + 22 * rows.length),
    xaxis: axis("RTE, deg/m", { rangemode: "tozero" }),
    yaxis: axis("", { tickvals: places, ticktext: names, range: [-0.7, rows.length - 0.3], title: undefined }),
  }), PLAIN);
}

function drawnRows(most) {
  const first = ["CAM_FRONT", "LINEAR", "HUBER", "MIXO"];
  const rows = found().filter((row) => !row.privileged);
  const known = rows.filter((row) => first.includes(row.policy));
  return shown.search ? rows.slice(0, most) : [...new Set([...rows.slice(0, 2), ...known, ...rows])].slice(0, most);
}

function drawLengths() {
  const whole = groups()[0].rows;
  const traces = drawnRows(6).map((row) => whole.find((one) => one.policy === row.policy) ?? row)
    .filter((row) => row.lengths.length).map((row) => {
      const at = row.lengths.filter((one) => one.rotation_deg_per_m.mean !== null);
      const value = at.map((one) => one.rotation_deg_per_m);
      const look = style(row.policy);
      return {
        name: label(rowName(row)), x: at.map((one) => one.length_m), y: value.map((one) => one.mean), type: "scatter",
        mode: "lines+markers", line: { color: look.color, dash: look.dash }, marker: { symbol: look.symbol, size: 8 },
        error_y: { type: "data", symmetric: false, thickness: 1, array: value.map((one) => (one.high ?? one.mean) - one.mean),
          arrayminus: value.map((one) => one.mean - (one.low ?? one.mean)) },
        text: at.map((one) => `${label(row.policy)}, ${one.length_m} m<br>${interval(one.rotation_deg_per_m, 4)} deg/m, ` +
          `${fixed(one.translation_percent.mean, 2)} %<br>${one.samples} pieces`),
        hoverinfo: "text",
      };
    });
  Plotly.react("lengths", traces, layout({
    height: 400, xaxis: axis("length of the piece of path, m"), yaxis: axis("RTE, deg/m", { rangemode: "tozero" }),
  }), PLAIN);
}
