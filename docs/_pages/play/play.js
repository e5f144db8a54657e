"use strict";
// The game. Names from data only ever become text. Last: the page begins here.
const byId = (id) => document.getElementById(id);
const PHRASES = { t: "tracking", l: "✕ lost", i: "· starting up", n: "· no picture" };
const game = { you: null, rows: [], timer: null, cards: [] };

function element(name, text, attributes = {}) {
  const made = document.createElement(name);
  if (text !== undefined) made.textContent = text;
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  return made;
}

const scores = () => game.cards.map((card) => Number(card.slider.value));
const rules = () => ({ shares: true, hide: byId("hide").checked });
const fixed = (value, digits) => (value === null ? "-" : value.toFixed(digits));

function makeCard(name, j) {
  const box = element("div", undefined, { class: "expert", role: "group", "aria-label": name });
  box.style.borderTopColor = COLOURS[j % 6];
  const card = { box, picture: element("canvas", undefined, { role: "img", "aria-label": `${name}, picture` }) };
  card.claim = element("div", "", { class: "claim" });
  card.state = element("div", "", { class: "state" });
  card.slider = element("input", undefined, { type: "range", min: 0, max: 100, step: 1, value: 50, "aria-label": `weight of ${name}` });
  card.share = element("output");
  card.seen = element("div", "", { class: "seen" });
  const alone = element("button", "only this one", { type: "button", class: "alone" });
  alone.addEventListener("click", () => setWeights(DRIVE.experts.map((_, i) => (i === j ? 100 : 0))));
  card.slider.addEventListener("input", drawExperts);
  const weight = element("div", undefined, { class: "weight" });
  weight.append(card.slider, card.share);
  box.append(element("h3", name));
  if (DRIVE.pictures.sheets[name]) box.append(card.picture);
  box.append(card.claim, card.state, weight, card.seen, alone);
  card.sheet = new Image();
  card.sheet.addEventListener("load", drawExperts);
  if (DRIVE.pictures.sheets[name]) card.sheet.src = DRIVE.pictures.sheets[name];
  return card;
}

function setWeights(values) {
  values.forEach((value, j) => { game.cards[j].slider.value = value; });
  drawExperts();
}

function drawPicture(card, step) {
  if (!card.sheet.complete || !card.sheet.naturalWidth) return;
  const { width, height, columns, every } = DRIVE.pictures;
  const frame = Math.floor((step + 1) / every); // the picture that closes the step, or the one before it
  card.picture.width = width;
  card.picture.height = height;
  const from = [(frame % columns) * width, Math.floor(frame / columns) * height];
  card.picture.getContext("2d").drawImage(card.sheet, ...from, width, height, 0, 0, width, height);
}

// What is known before the coming step is decided; after the last one, the last again.
function drawExperts() {
  const step = Math.min(game.you.step, STEPS - 1);
  const { hide } = rules();
  const given = scores();
  const votes = DRIVE.claims_rad[step].map((claim) => claim !== null || !hide);
  const total = given.reduce((sum, value, j) => sum + (votes[j] ? value : 0), 0);
  const voters = votes.filter(Boolean).length;
  game.cards.forEach((card, j) => {
    const name = DRIVE.experts[j], claim = DRIVE.claims_rad[step][j], rate = (value) => (value / DRIVE.dt_s[step]) * DEGREES;
    const state = PHRASES[DRIVE.states[name]?.[step] ?? "t"];
    const matches = DRIVE.matches[name] && claim !== null ? `, ${DRIVE.matches[name][step]} matches` : "";
    const instead = hide ? "no vote" : `the inertial sensor votes: ${rate(DRIVE.substitute_rad[step]).toFixed(2)} deg/s`;
    card.claim.textContent = claim === null ? "-" : `${rate(claim) > 0 ? "+" : ""}${rate(claim).toFixed(2)} deg/s`;
    card.state.textContent = claim === null ? `${state}; ${instead}` : state + matches;
    card.box.classList.toggle("silent", claim === null);
    const share = !votes[j] ? 0 : total > 0 ? given[j] / total : 1 / voters;
    card.share.textContent = `${(100 * share).toFixed(0)} %`;
    card.slider.setAttribute("aria-valuetext", `${given[j]} of 100, ${card.share.textContent} of the vote`);
    const theirs = game.rows.slice(1).filter((row) => !row.knows);
    card.seen.textContent = theirs.map((row) => `${row.name} ${(100 * row.weights[step][j]).toFixed(0)}\u00a0%`).join(", ");
    drawPicture(card, step);
  });
}

function drawScores() {
  byId("scores").replaceChildren(...game.rows.map((row, i) => {
    const found = row.estimate.scores();
    const made = element("tr", undefined, i ? {} : { class: "you" });
    made.append(element("th", row.name, { scope: "row" }));
    for (const [name, digits] of [["now_deg", 3], ["ate_deg", 3], ["ate_m", 2], ["rte_deg_per_m", 4], ["yaw_rmse_deg", 4]]) {
      made.append(element("td", fixed(found[name], digits)));
    }
    return made;
  }));
}

function verdict() {
  const [mine, ...others] = game.rows.map((row) => row.estimate.scores().ate_deg);
  if (!game.you.step) return "Set the weights and press play.";
  const told = others.map((theirs, i) => {
    const name = game.rows[i + 1].name;
    if (!theirs) return `no error at all for ${name}`;
    const share = Math.round(100 * (mine / theirs - 1));
    return `${Math.abs(share)} % ${share > 0 ? "more" : "less"} than ${name}`;
  });
  return `Your yaw is off by ${mine.toFixed(3)} deg (RMSE): ${told.join(", ")}.`;
}

function draw() {
  const step = game.you.step, over = step >= STEPS;
  byId("progress").value = step / STEPS;
  byId("clock").textContent = `Step ${step} of ${STEPS}, ${times[step].toFixed(1)} s${over ? ". The drive is over: reset to try again." : ""}`;
  byId("run").textContent = game.timer === null ? "▶ Play" : "⏸ Pause";
  for (const id of ["run", "one", "end"]) byId(id).disabled = over;
  drawExperts();
  drawScores();
  // Read aloud where somebody listens: when the game stands still.
  byId("verdict").textContent = game.timer === null ? verdict() : "Playing.";
  drawCharts();
}

function drawCharts() {
  const magnify = Number(byId("magnify").value);
  drawPaths(byId("path"), game.rows, magnify);
  const off = game.rows.map((row) => `${row.name} ${fixed(Math.hypot(row.estimate.x.at(-1) - whole.x[row.estimate.step], row.estimate.y.at(-1) - whole.y[row.estimate.step]), 2)} m`);
  byId("path").setAttribute("aria-label", `Paths from above; off now: ${off.join(", ")}`);
  drawClaims(byId("claims"), Math.min(game.you.step, STEPS - 1), byId("minus").checked);
  byId("claims").setAttribute("aria-label", "Yaw rates over time of every expert, and crosses where it is lost; the same numbers stand under the pictures");
}

function advance() {
  if (game.you.step >= STEPS) return;
  const step = game.you.step;
  game.you.advance(scores(), rules());
  for (const row of game.rows.slice(1)) row.estimate.advance(row.weights[step], { shares: false, hide: false });
}

function pause() {
  clearTimeout(game.timer);
  game.timer = null;
}

function tick() {
  advance();
  if (game.you.step >= STEPS) pause();
  else game.timer = setTimeout(tick, (1000 * DRIVE.dt_s[game.you.step]) / Number(byId("speed").value));
  draw();
}

function toggle() {
  if (game.timer === null) tick();
  else { pause(); draw(); }
}

function one() {
  pause();
  advance();
  draw();
}

function toTheEnd() {
  pause();
  while (game.you.step < STEPS) advance();
  draw();
}

function reset() {
  pause();
  game.you = new Estimate();
  game.rows = [
    { name: "You", estimate: game.you, look: LOOKS.you },
    ...DRIVE.rows.map((row, i) => ({ ...row, name: row.knows ? `${row.name} †` : row.name, estimate: new Estimate(), look: rowLook(i) })),
  ];
  draw();
}

const KEYS = { " ": toggle, ArrowRight: one, e: toTheEnd, r: reset };

// Keys that a control of its own understands are left to it.
function press(event) {
  const does = KEYS[event.key.length === 1 ? event.key.toLowerCase() : event.key];
  if (!does || event.ctrlKey || event.metaKey || event.altKey) return;
  const own = { " ": "button, select, input, [type=checkbox]", ArrowRight: "select, input, .wide" }[event.key] ?? "select";
  if (event.target.closest?.(own)) return;
  event.preventDefault();
  does();
}

function begin() {
  byId("heading").textContent = `Play a drive: ${DRIVE.scene}`;
  byId("about").textContent = `This is ${DRIVE.scene} (${DRIVE.conditions.join(", ")}; log ${DRIVE.log}) of ${DRIVE.data}, ` +
    `track ${DRIVE.track}. The rows to beat learned on other logs (fold ${DRIVE.fold} was held out).`;
  game.you = new Estimate();
  game.cards = DRIVE.experts.map(makeCard);
  byId("experts").replaceChildren(...game.cards.map((card) => card.box));
  const clicks = { run: toggle, one, end: toTheEnd, again: reset, equal: () => setWeights(DRIVE.experts.map(() => 50)) };
  for (const [id, does] of Object.entries(clicks)) byId(id).addEventListener("click", does);
  byId("hide").addEventListener("change", drawExperts);
  for (const id of ["magnify", "minus"]) byId(id).addEventListener("change", drawCharts);
  window.addEventListener("resize", drawCharts);
  document.addEventListener("keydown", press);
  reset();
  document.body.dataset.ready = "yes";
}

begin();
