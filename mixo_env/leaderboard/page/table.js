"use strict";
// The table of rows: choice of track and scenes, search, sorting. Names from data only ever become text.
const DATA = JSON.parse(document.getElementById("data").textContent);
const byId = (id) => document.getElementById(id);
const shown = { track: Object.keys(DATA.tracks)[0], group: 0, search: "", sort: "RTE deg/m", down: false };

function element(name, text, attributes = {}) {
  const made = document.createElement(name);
  if (text !== undefined) made.textContent = text;
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  return made;
}

const fixed = (value, digits) => (typeof value === "number" ? value.toFixed(digits) : "-");
const percent = (share) => (typeof share === "number" ? `${share > 0 ? "+" : ""}${(100 * share).toFixed(1)} %` : "-");
const chance = (p) => (p < 1e-4 ? "<.0001" : p.toFixed(4).replace(/^0/, ""));

function interval(value, digits) {
  if (!value || value.mean === null) return "-";
  const ends = value.low === null ? "" : ` [${fixed(value.low, digits)}, ${fixed(value.high, digits)}]`;
  return fixed(value.mean, digits) + ends;
}

function difference(reference) {
  return {
    name: `- ${reference}`,
    value: (row) => row.differences[reference]?.share,
    text: (row) => {
      const found = row.differences[reference];
      return found ? `${percent(found.share)} (${chance(found.p_holm)})${found.p_holm < 0.05 ? " ●" : ""}` : "-";
    },
  };
}

const rowName = (row) => row.policy + (row.privileged ? " †" : "") + (row.reference ? " *" : "");
const COLUMNS = [
  { name: "Row", value: (row) => row.policy, text: rowName },
  { name: "RTE deg/m", value: (row) => row.rotation_deg_per_m.mean, text: (row) => interval(row.rotation_deg_per_m, 4) },
  { name: "Letters", value: (row) => row.letters || "~", text: (row) => row.letters || "-" },
  difference("LINEAR"),
  difference("MIXO"),
  { name: "RTE %", value: (row) => row.translation_percent.mean, text: (row) => fixed(row.translation_percent.mean, 2) },
  { name: "ATE m", value: (row) => row.ate_m, text: (row) => fixed(row.ate_m, 2) },
  { name: "ATE deg", value: (row) => row.ate_deg, text: (row) => fixed(row.ate_deg, 3) },
  { name: "IQM deg/m", value: (row) => row.interquartile_mean_deg_per_m, text: (row) => fixed(row.interquartile_mean_deg_per_m, 4) },
  { name: "P(< LINEAR)", value: (row) => row.probability_of_improvement?.LINEAR, text: (row) => fixed(row.probability_of_improvement?.LINEAR, 2) },
  { name: "Lost/scene", value: (row) => row.lost_per_scene?.mean, text: (row) => fixed(row.lost_per_scene?.mean, 2) },
  { name: "ATE > 0.5 m", value: (row) => row.high_ate_share, text: (row) => `${fixed(100 * row.high_ate_share, 0)} %` },
];

const groups = () => DATA.tracks[shown.track].groups;
const group = () => groups()[shown.group];

function sorted(rows, column, down) {
  const missing = (value) => value === undefined || value === null;
  return [...rows].sort((a, b) => {
    const [one, two] = [column.value(a), column.value(b)];
    if (missing(one) || missing(two)) return missing(one) - missing(two); // rows without a number come last either way
    const order = typeof one === "number" ? one - two : String(one).localeCompare(String(two));
    return down ? -order : order;
  });
}

function found() {
  const wanted = shown.search.toLowerCase();
  const rows = group().rows.filter((row) => row.policy.toLowerCase().includes(wanted));
  return sorted(rows, COLUMNS.find((column) => column.name === shown.sort), shown.down);
}

function drawHead() {
  const line = element("tr");
  for (const column of COLUMNS) {
    const chosen = column.name === shown.sort;
    const order = chosen ? (shown.down ? "descending" : "ascending") : "none";
    const cell = element("th", undefined, { scope: "col", "aria-sort": order });
    const button = element("button", column.name + (chosen ? (shown.down ? " ▼" : " ▲") : ""), { type: "button" });
    button.addEventListener("click", () => {
      shown.down = chosen && !shown.down;
      shown.sort = column.name;
      drawTable();
      byId("rows").querySelectorAll("thead button")[COLUMNS.indexOf(column)].focus();
    });
    cell.append(button);
    line.append(cell);
  }
  const head = element("thead");
  head.append(line);
  return head;
}

function body(rows, columns) {
  const made = element("tbody");
  for (const row of rows) {
    const line = element("tr");
    columns.forEach((column, i) => {
      const text = column.text(row);
      line.append(i ? element("td", text) : element("th", text, { scope: "row", title: text }));
    });
    made.append(line);
  }
  return made;
}

function drawTable() {
  const rows = found();
  byId("rows").replaceChildren(drawHead(), body(rows, COLUMNS));
  const scenes = group().rows[0]?.scenes ?? 0;
  byId("counted").textContent =
    `Track ${shown.track}, ${group().name}: ${rows.length} of ${group().rows.length} rows, ${scenes} scenes.`;
}

const share = (part, energy) => `${fixed(100 * part, 1)} % (${fixed(100 * energy, 0)} %)`;
const PARTS_OF_ERROR = [
  { name: "Row", text: rowName },
  ...["1.0", "5.0", "20.0"].map((window) => ({
    name: `bias ${Number(window)} s, deg/s`,
    text: (row) => fixed(row.anatomy.bias_deg_per_s[window], 4),
  })),
  { name: "outliers (of squared error)", text: (row) => share(row.anatomy.outlier_share, row.anatomy.outlier_energy) },
  {
    name: "all lost (of squared error)",
    text: (row) => (row.anatomy.all_lost_share === null ? "-" : share(row.anatomy.all_lost_share, row.anatomy.all_lost_energy)),
  },
  { name: "along m", text: (row) => fixed(row.anatomy.along_track_rmse_m, 3) },
  { name: "across m", text: (row) => fixed(row.anatomy.cross_track_rmse_m, 3) },
];

function drawAnatomy() {
  const head = element("thead");
  const line = element("tr");
  for (const column of PARTS_OF_ERROR) line.append(element("th", column.name, { scope: "col" }));
  head.append(line);
  const rows = groups().flatMap((one) => (["all", "fold"].includes(one.by) ? one.rows : [])).filter((row) => row.anatomy);
  const once = rows.filter((row, i) => rows.findIndex((other) => other.policy === row.policy) === i);
  byId("anatomy").replaceChildren(head, body(once, PARTS_OF_ERROR));
  byId("sigmas").textContent = DATA.outlier_sigmas;
}

function options(select, names, values = names) {
  select.replaceChildren(...names.map((name, i) => element("option", name, { value: values[i] })));
}

function fillGroups() {
  const names = groups().map((one) => (one.by === "all" ? one.name : `${one.by}: ${one.name}`));
  options(byId("group"), names, names.map((_, i) => i));
  shown.group = Math.min(shown.group, names.length - 1);
  byId("group").value = shown.group;
}

function drawFailures() {
  const failures = DATA.failures;
  const place = byId("failures");
  if (!failures) {
    place.replaceChildren(element("p", "Not recorded in this folder of results."));
    return;
  }
  const privileged = new Set(failures.privileged);
  const rows = Object.entries(failures.matrix); // row -> kind -> RTE
  const kinds = [...new Set(rows.flatMap(([, values]) => Object.keys(values)))];
  const least = (kind) =>
    Math.min(...rows.filter(([row]) => !privileged.has(row)).map(([, values]) => values[kind] ?? Infinity));
  const best = Object.fromEntries(kinds.map((kind) => [kind, least(kind)]));
  const leads = (row, value, kind) => !privileged.has(row) && value === best[kind];
  const cell = (kind) => ([row, values]) => fixed(values[kind], 4) + (leads(row, values[kind], kind) ? " ●" : "");
  const head = element("thead");
  const line = element("tr");
  for (const name of ["Row", ...kinds]) line.append(element("th", name.replaceAll("_", " "), { scope: "col" }));
  head.append(line);
  const names = { text: ([row]) => row + (privileged.has(row) ? " †" : "") };
  const table = element("table");
  table.append(head, body(rows, [names, ...kinds.map((kind) => ({ text: cell(kind) }))]));
  const scenes = [...new Set(Object.values(failures.scenes))].join(" or ");
  const told =
    `RTE in deg/m by exact truth, track ${failures.track}, ${scenes} scenes of as many drives in every column. ` +
    `Rows were fitted on ${failures.data_version} alone. † reads the truth or the future; ● marks the least of the others in its column.`;
  place.replaceChildren(element("p", told, { class: "small" }), table);
}

function drawMade() {
  byId("conventions").replaceChildren(...DATA.conventions.map((line) => element("li", line)));
  byId("software").textContent =
    Object.entries(DATA.software).map(([name, version]) => `${name} ${version}`).join(", ") +
    ". " + DATA.tracks[shown.track].left_out.join(" ");
  byId("hashes").textContent = Object.entries(DATA.hashes).map(([name, hash]) => `${name}  ${hash}`).join("\n");
}
