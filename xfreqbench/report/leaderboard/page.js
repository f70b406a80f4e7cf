"use strict";
// The tables stand in the page already; this sorts, filters and hides their rows, and draws the charts.
// Names of methods come from plug-ins: they reach the page as text content and attributes, never as HTML.

const content = JSON.parse(document.getElementById("content").textContent);
const SVG = "http://www.w3.org/2000/svg";
const DASHES = ["", "7 3", "2 3", "9 3 2 3"];
const find = (selector, root = document) => root.querySelector(selector);
const all = (selector, root = document) => [...root.querySelectorAll(selector)];

// ---- elements

function element(name, attributes = {}, ...children) {
  const made = document.createElement(name);
  return filled(made, attributes, children);
}

function drawn(name, attributes = {}, ...children) {
  return filled(document.createElementNS(SVG, name), attributes, children);
}

function filled(made, attributes, children) {
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.append(...children);
  return made;
}

function fill(select, choices) {
  const before = select.value;
  select.replaceChildren(...choices.map(([value, text]) => element("option", { value }, text)));
  if (choices.some(([value]) => value === before)) select.value = before;
}

// ---- what is shown

const board = () => content.boards.find((each) => each.slug === find("#board").value);
const splitSet = () => board().sets[find("#set").value];
const shownSet = () => find(`.board[data-board="${find("#board").value}"] .set[data-set="${find("#set").value}"]`);
const table = () => find("table", shownSet());

// Labels of the rows that the filter leaves, the best first, however the table is sorted.
function shownRows() {
  const shown = new Set(all("tbody tr:not([hidden])", table()).map((row) => row.dataset.label));
  return Object.keys(splitSet().rows).filter((name) => shown.has(name));
}

// Rows that would squeeze the others on a chart's axis: their error is more than twice that of the best trivial
// predictor and that of the best method. Where no other row is shown, there are none.
function offScale() {
  const rows = Object.entries(splitSet().rows);
  const least = (isTrivial) => Math.min(...rows.filter(([name]) => (familyOf(name) === "trivial") === isTrivial).map(([, row]) => 1 - row.ssim));
  const limit = 2 * Math.max(...[least(true), least(false)].filter(Number.isFinite));
  const far = shownRows().filter((name) => 1 - splitSet().rows[name].ssim > limit);
  return far.length < shownRows().length ? far : [];
}

const familyOf = (name) => board().rows[name].family;
const chartedRows = () => { const far = offScale(); return shownRows().filter((name) => !far.includes(name)); };

function isShown(row) {
  const wanted = find("#filter").value.trim().toLowerCase();
  const families = all("#families input:checked").map((box) => box.value);
  return families.includes(row.dataset.family) && row.dataset.label.toLowerCase().includes(wanted);
}

function showBoard() {
  const sets = all(`.board[data-board="${find("#board").value}"] .set`);
  fill(find("#set"), sets.map((set) => [set.dataset.set, set.dataset.title]));
  fill(find("#metric"), Object.entries(board().metrics));
  fill(find("#shown-method"), Object.keys(board().gallery.cases).map((label) => [label, label]));
  const families = new Set(Object.values(board().rows).map(({ family }) => family));
  for (const box of all("#families input")) box.parentNode.hidden = !families.has(box.value);
  find("#families").hidden = families.size < 2;
  for (const choice of ["#board", "#set"]) find(choice).parentNode.hidden = find(choice).options.length < 2;
  showSet();
}

function showSet() {
  for (const section of all(".board")) section.hidden = section.dataset.board !== find("#board").value;
  for (const set of all(".set")) set.hidden = set.dataset.set !== find("#set").value;
  filterRows();
}

function filterRows() {
  const rows = all("tbody tr", table());
  for (const row of rows) row.hidden = !isShown(row);
  find("#shown").textContent = `${rows.filter((row) => !row.hidden).length} of ${rows.length} methods shown.`;
  draw();
}

function showAllRows() {
  find("#filter").value = "";
  for (const box of all("#families input")) box.checked = true;
  filterRows();
}

// ---- sorting

function makeSortable(head) {
  const button = element("button", { type: "button" }, head.textContent);
  head.replaceChildren(button);
  button.addEventListener("click", () => sortBy(head));
}

function sortBy(head) {
  const opposite = { ascending: "descending", descending: "ascending" };
  const direction = opposite[head.getAttribute("aria-sort")] ?? head.dataset.first;
  for (const other of head.parentNode.cells) other.removeAttribute("aria-sort");
  head.setAttribute("aria-sort", direction);
  sortRows(head);
  writeAddress();
}

function sortRows(head) {
  const direction = head.getAttribute("aria-sort");
  const body = head.closest("table").tBodies[0];
  body.append(...sorted([...body.rows], (row) => sortKey(row.cells[head.cellIndex]), direction));
}

const sortKey = (cell) => (cell.dataset.value === undefined ? cell.textContent : number(cell.dataset.value));
const number = (text) => ({ "": NaN, inf: Infinity, "-inf": -Infinity })[text] ?? Number(text);

function sorted(rows, key, direction) {
  const sign = direction === "ascending" ? 1 : -1;
  const isAbsent = (row) => Number.isNaN(key(row));
  const present = rows.filter((row) => !isAbsent(row));
  present.sort((a, b) => sign * compare(key(a), key(b)));
  return [...present, ...rows.filter(isAbsent)];
}

const compare = (a, b) => (typeof a === "string" ? a.localeCompare(b, "en") : a === b ? 0 : a - b);

// ---- scales

function linearTicks([low, high], count) {
  const rough = (high - low) / count;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].find((each) => each * power >= rough) * power;
  const first = Math.ceil(low / step - 1e-9);
  const number = Math.floor(high / step + 1e-9) - first + 1;
  return Array.from({ length: number }, (_, index) => (first + index) * step);
}

function logTicks([low, high], count) {
  const decades = Math.log10(high / low);
  if (decades < 0.5) return linearTicks([low, high], count);
  const digits = [[1, 2, 3, 5], [1, 2, 5], [1, 3], [1]].find((each) => each.length * decades <= count) ?? [1];
  const every = Math.ceil(decades / count);
  const ticks = [];
  for (let power = Math.floor(Math.log10(low)); power <= Math.log10(high); power += every)
    for (const digit of digits) ticks.push(Number(`${digit}e${power}`));
  return ticks.filter((tick) => tick >= low * 0.999 && tick <= high * 1.001);
}

// Maps a domain to pixels: `at` gives a value's place, `ticks` those of the axis.
function scale(domain, pixels, log, count) {
  const through = log ? Math.log10 : (value) => value;
  const [low, high] = domain.map(through);
  const at = (value) => pixels[0] + ((through(value) - low) / (high - low)) * (pixels[1] - pixels[0]);
  return { at, ticks: (log ? logTicks : linearTicks)(domain, count) };
}

function extent(values, { log = false, margin = 0.05 } = {}) {
  const finite = values.filter((value) => Number.isFinite(value) && (!log || value > 0));
  if (!finite.length) return log ? [0.1, 10] : [0, 1];
  const [low, high] = [Math.min(...finite), Math.max(...finite)];
  if (log) return low < high ? [low / 1.15, high * 1.15] : [low / 2, high * 2];
  const space = low < high ? (high - low) * margin : Math.abs(low) * 0.05 || 0.5;
  return [low - space, high + space];
}

function readable(value) {
  const size = Math.abs(value);
  if (size >= 1e6) return `${Number((value / 1e6).toPrecision(3))}M`;
  if (size >= 1e4) return `${Number((value / 1e3).toPrecision(3))}k`;
  return String(Number(value.toPrecision(3)));
}

// ---- charts

// An empty chart with axes: `x` and `y` have a label and values, or a domain, and may be log.
function chart(host, title, height, x, y) {
  const figure = element("figure", {}, ...(title ? [element("figcaption", {}, title)] : []));
  host.append(figure);
  const width = Math.max(240, Math.min(figure.clientWidth, 900));
  const box = { left: 52, right: width - 16, top: 8, bottom: height - 36 };
  const svg = drawn("svg", { viewBox: `0 0 ${width} ${height}`, width, height, role: "group", "aria-label": title });
  const xScale = scale(x.domain ?? extent(x.values, x), [box.left, box.right], x.log, x.count ?? width / 80);
  const yScale = scale(y.domain ?? extent(y.values, y), [box.bottom, box.top], y.log, 5);
  const xTicks = xScale.ticks.filter((tick) => tick >= (x.from ?? -Infinity));
  svg.append(...xTicks.flatMap((tick) => xTick(xScale.at(tick), box, readable(tick))));
  svg.append(...yScale.ticks.flatMap((tick) => yTick(yScale.at(tick), box, readable(tick))));
  svg.append(label((box.left + box.right) / 2, height - 4, x.label, "middle"));
  const middle = (box.top + box.bottom) / 2;
  svg.append(filled(label(12, middle, y.label, "middle"), { transform: `rotate(-90 12 ${middle})` }, []));
  figure.append(svg);
  return { svg, box, x: xScale.at, y: yScale.at };
}

const label = (x, y, text, anchor = "start", kind = "") =>
  drawn("text", { x, y, "text-anchor": anchor, class: kind }, text);
const line = (x1, y1, x2, y2, kind) => drawn("line", { x1, y1, x2, y2, class: kind });
const xTick = (at, box, text) => [
  line(at, box.top, at, box.bottom, "grid"), label(at, box.bottom + 14, text, "middle", "tick")];
const yTick = (at, box, text) => [
  line(box.left, at, box.right, at, "grid"), label(box.left - 5, at + 4, text, "end", "tick")];
const path = (points) => points.map(([x, y], index) => `${index ? "L" : "M"}${x.toFixed(1)} ${y.toFixed(1)}`).join("");

// Colour, dashes and marker: of a row of the page, or of a series of a measurement by its place.
const style = (place, variant) => ({
  colour: content.colours[place % content.colours.length], dash: DASHES[variant % DASHES.length],
  shape: MARKERS[(place + variant) % MARKERS.length] });
const styleOf = (name) => style(...content.styles[name]);
const seriesStyle = (place) => style(place, Math.floor(place / content.colours.length));

function curve(plot, name, points, { colour, dash }, text) {
  const places = points.filter(([, y]) => y !== null).map(([x, y]) => [plot.x(x), plot.y(y)]);
  const made = drawn("path", { class: "curve", d: path(places), stroke: colour, "stroke-dasharray": dash, "data-row": name });
  explain(made, text);
  plot.svg.append(made);
  return places;
}

const MARKERS = ["M-4 0A4 4 0 1 0 4 0A4 4 0 1 0-4 0Z", "M-4-4H4V4H-4Z", "M0-5L5 4H-5Z", "M0-5L5 0L0 5L-5 0Z", "M0 5L5-4H-5Z"];

function marker(x, y, name, small, { colour, shape } = styleOf(name)) {
  const transform = `translate(${x.toFixed(1)} ${y.toFixed(1)})${small ? " scale(.7)" : ""}`;
  return drawn("path", { d: shape, transform, fill: colour, "data-row": name });
}

function withMarkers(plot, name, places) {
  plot.svg.append(...places.map(([x, y]) => marker(x, y, name, true)));
}

function empty(host, text) {
  host.replaceChildren(element("p", { class: "note" }, text));
}

// ---- the four kinds of charts

// The axis of costs has whole decades. What costs nothing has no place on it: points cheaper than `least` lie one
// decade to the left of all others. Points whose cost is not known are left out.
function drawPareto(host) {
  host.replaceChildren();
  const cost = find("#cost");
  const least = { seconds: 0.1, milliseconds: 0.001, parameters: 1 }[cost.value];
  const points = shownRows().map((name) => ({ name, ...splitSet().rows[name], cost: splitSet().rows[name][cost.value] }))
    .filter((point) => point.cost !== null);
  if (!points.length) return empty(host, "No method is shown whose cost is known.");
  const dear = points.filter((point) => point.cost >= least);
  const hasEdge = dear.length < points.length;
  const decade = (value, round) => 10 ** round(Math.log10(value));
  const costs = dear.length ? dear.map((point) => point.cost) : [1];
  const low = decade(Math.min(...costs), Math.floor);
  const high = Math.max(decade(Math.max(...costs), Math.ceil), 10 * low);
  const place = (point) => (point.cost < least ? low / 10 : point.cost);
  const far = offScale();
  const near = points.filter((point) => !far.includes(point.name));
  const [bottom, top] = extent(near.map((point) => point.ssim), { margin: 0.12 });
  for (const point of points) point.height = Math.max(point.ssim, bottom);
  const plot = chart(host, "", host.clientWidth < 500 ? 340 : 400,
    { label: cost.selectedOptions[0].textContent, domain: [hasEdge ? low / 13 : low, high], log: true, from: low, count: 5 },
    { label: "average median SSIM", domain: [bottom, top] });
  if (hasEdge) plot.svg.append(...xTick(plot.x(low / 10), plot.box, cost.value === "parameters" ? "0" : `< ${least}`));
  if (near.length) drawFront(plot, near, place);
  const taken = points.map((point) => around(plot.x(place(point)), plot.y(point.height)));
  for (const point of points) plot.svg.append(pointOf(plot, point, place(point)));
  const marks = [...taken];
  for (const [nth, point] of points.entries()) nameBeside(plot, point, marks[nth], marks, taken);
}

function drawFront(plot, points, place) {
  const front = [];
  for (const point of [...points].sort((a, b) => place(a) - place(b) || b.ssim - a.ssim))
    if (!front.length || point.ssim > front.at(-1).ssim) front.push(point);
  const corners = front.flatMap((point, index) => [
    ...(index ? [[plot.x(place(point)), plot.y(front[index - 1].ssim)]] : []), [plot.x(place(point)), plot.y(point.ssim)]]);
  plot.svg.append(drawn("path", { class: "front", d: path([...corners, [plot.box.right, corners.at(-1)[1]]]) }));
}

function pointOf(plot, point, x) {
  const made = marker(plot.x(x), plot.y(point.height), point.name);
  filled(made, { tabindex: 0, role: "button", class: "point" }, []);
  explain(made, summary(point));
  made.addEventListener("click", () => showMapsOf(point.name));
  made.addEventListener("keydown", (event) => {
    if (event.key !== "Enter" && event.key !== " ") return;
    event.preventDefault();
    showMapsOf(point.name);
  });
  return made;
}

function summary(row) {
  const known = row.interval[0] !== null;
  return [row.name,
    `average median SSIM ${row.ssim.toFixed(4)}${known ? ` [${row.interval.map((each) => each.toFixed(4)).join(", ")}]` : ""}`,
    ...(row.skill === null ? [] : [`skill ${row.skill.toFixed(3)}`]),
    ...(row.seconds === null ? [] : [`${readable(row.seconds)} s of fitting`]),
    ...(row.milliseconds === null ? [] : [`${readable(row.milliseconds)} ms a map`]),
    ...(row.parameters === null ? [] : [`${Math.round(row.parameters).toLocaleString("en")} parameters`])].join("\n");
}

const around = (x, y) => ({ left: x - 6, right: x + 6, top: y - 6, bottom: y + 6 });
const overlap = (a, b) => a.left < b.right && b.left < a.right && a.top < b.bottom && b.top < a.bottom;

const gap = (a, b) =>
  Math.hypot(Math.max(a.left - b.right, b.left - a.right, 0), Math.max(a.top - b.bottom, b.top - a.bottom, 0));

// A name goes to the first free place near its mark that no other mark is nearer to, or else to the first free one.
// What is far off, or nearer to another mark, has a line to its own. Where no place is free, the tip alone says it.
function nameBeside(plot, point, own, marks, taken) {
  const [x, y] = [(own.left + own.right) / 2, (own.top + own.bottom) / 2];
  const text = label(0, 0, point.height > point.ssim ? `${point.name} ↓ ${point.ssim.toFixed(3)}` : point.name);
  plot.svg.append(text);
  const width = text.getComputedTextLength();
  const free = [4, -8, 16, -20, 28, -32, 40].flatMap((dy) => [[9, dy], [-9 - width, dy], [-width / 2, dy]])
    .map(([dx, dy]) => ({ left: x + dx, right: x + dx + width, top: y + dy - 9, bottom: y + dy + 2 }))
    .filter((box) => box.left >= plot.box.left && box.right <= plot.box.right && box.top >= 0)
    .filter((box) => box.bottom <= plot.box.bottom && !taken.some((other) => overlap(box, other)));
  const isClear = (box) => marks.every((mark) => mark === own || gap(box, own) < gap(box, mark));
  const box = free.find(isClear) ?? free[0];
  if (!box) return text.remove();
  taken.push(box);
  const within = (at, low, high) => Math.min(Math.max(at, low), high);
  if (!isClear(box) || gap(box, own) > 8)
    text.before(line(x, y, within(x, box.left, box.right), within(y, box.top, box.bottom), "leader"));
  filled(text, { x: box.left, y: box.bottom - 2, "data-row": point.name }, []);
}

function drawCurves(host) {
  host.replaceChildren();
  for (const split of splitSet().splits) {
    const followed = chartedRows().filter((name) => splitOf(name, split).curve.length);
    if (!followed.length) continue;
    const errors = Object.fromEntries(followed.map((name) => [name, errorsOf(name, split)]));
    const points = Object.values(errors).flat();
    const { name: title, trivial } = board().splits[split];
    const least = trivial === null ? null : errorOf(trivial);
    const plot = chart(host, title, 260,
      { label: "seconds of fitting", values: points.map(([x]) => x), log: true },
      { label: "1 − median SSIM", values: [...points.map(([, y]) => y), least], log: true });
    if (least !== null) plot.svg.append(line(plot.box.left, plot.y(least), plot.box.right, plot.y(least), "trivial"));
    for (const name of followed) withMarkers(plot, name, curve(plot, name, errors[name], styleOf(name), name));
  }
  if (!host.children.length) empty(host, "None of the shown methods has a learning curve: they need a budget, and several steps.");
}

const errorOf = (ssim) => Math.max(1 - ssim, 1e-4);
const errorsOf = (name, split) => splitOf(name, split).curve.map(([seconds, ssim]) => [seconds, errorOf(ssim)]);
const splitOf = (name, split) => board().rows[name].splits[split];

function drawCarriers(host) {
  host.replaceChildren();
  const { splits } = splitSet();
  const tested = splits.map((split) => splitOf(Object.keys(splitSet().rows)[0], split).carriers.length);
  const panels = tested.every((number) => number === 1) ? [splits] : splits.map((split) => [split]);
  for (const panel of panels) drawCarrierPanel(host, panel);
  if (!host.children.length) empty(host, "One carrier is tested on this board: the table above says it all.");
}

function drawCarrierPanel(host, splits) {
  const points = Object.fromEntries(chartedRows().map((name) => [name, splits.flatMap((split) => splitOf(name, split).carriers)]));
  const carriers = new Set(Object.values(points).flat().map(([x]) => x));
  if (carriers.size < 2) return;
  const plot = chart(host, splits.length === 1 ? board().splits[splits[0]].name : "", 260,
    { label: "carrier (GHz)", values: [...carriers], log: true },
    { label: "median SSIM", values: Object.values(points).flat().map(([, y]) => y) });
  for (const [name, curvePoints] of Object.entries(points)) {
    const ordered = [...curvePoints].sort(([a], [b]) => a - b);
    withMarkers(plot, name, curve(plot, name, ordered, styleOf(name), name));
  }
}

function drawDistributions(host) {
  host.replaceChildren();
  const metric = find("#metric");
  for (const split of splitSet().splits) {
    const quantiles = Object.fromEntries(chartedRows().map((name) => [name, splitOf(name, split).cdf[metric.value]]));
    const plot = chart(host, board().splits[split].name, 260,
      { label: metric.selectedOptions[0].textContent, values: Object.values(quantiles).flat(), margin: 0 },
      { label: "share of maps", domain: [0, 1] });
    for (const [name, values] of Object.entries(quantiles)) {
      const levels = values.map((value, index) => [value, value === null ? null : index / (values.length - 1)]);
      curve(plot, name, levels, styleOf(name), name);
    }
  }
}

function drawMeasurements() {
  content.benches.forEach((figure, number) => {
    const section = find(`.bench[data-bench="${number}"]`);
    find(".panels", section)?.remove();
    if (!figure) return;
    const host = element("div", { class: "panels wide" });
    section.append(host);
    const plot = chart(host, "", 300,
      { label: figure.x_label, values: figure.points.map((point) => point.x), log: figure.log_x },
      { label: figure.y_label, values: figure.points.map((point) => point.y) });
    [...new Set(figure.points.map((point) => point.series))].forEach((series, index) => drawSeries(plot, figure, series, index));
  });
}

function drawSeries(plot, figure, series, index) {
  const points = figure.points.filter(({ series: of, x, y }) => of === series && x !== null && y !== null);
  if (!points.length) return;
  const places = curve(plot, series, points.map(({ x, y }) => [x, y]), seriesStyle(index), series);
  points.forEach((point, place) => {
    const made = marker(...places[place], series, false, seriesStyle(index));
    explain(made, `${series}, ${point.label}\n${figure.x_label} ${readable(point.x)}\n${figure.y_label} ${readable(point.y)}`);
    plot.svg.append(made);
  });
  plot.svg.append(filled(label(...places.at(-1), series, "end"), { dx: -8, dy: -8 }, []));
}

function drawLegend() {
  const items = shownRows().map((name) => {
    const { colour, dash } = styleOf(name);
    const swatch = drawn("svg", { width: 30, height: 12, "aria-hidden": "true" });
    swatch.append(drawn("path", { d: "M0 6H30", class: "curve", stroke: colour, "stroke-dasharray": dash }), marker(15, 6, name, true));
    const item = element("li", {}, swatch, name);
    item.addEventListener("pointerenter", () => highlight(name));
    item.addEventListener("pointerleave", () => highlight(null));
    return item;
  });
  find("#legend").replaceChildren(...items);
  const far = offScale().map((name) => `${name} (${splitSet().rows[name].ssim.toFixed(4)})`);
  find("#off-scale").textContent = far.length
    ? `Off the scale of the charts, with more than twice the error of the best trivial predictor: ${far.join(", ")}.` : "";
}

function highlight(name) {
  for (const part of all("#charts .panels [data-row]")) part.classList.toggle("dim", name !== null && part.dataset.row !== name);
}

// ---- the tip that explains a point or a line

function explain(part, text) {
  part.setAttribute("aria-label", text);
  part.addEventListener("pointerenter", (event) => showTip(text, event.pageX, event.pageY));
  part.addEventListener("focus", () => {
    const box = part.getBoundingClientRect();
    showTip(text, box.right + scrollX, box.bottom + scrollY);
  });
  for (const end of ["pointerleave", "blur"]) part.addEventListener(end, () => { find("#tip").hidden = true; });
}

function showTip(text, x, y) {
  const tip = find("#tip");
  tip.textContent = text;
  tip.hidden = false;
  const room = scrollX + document.documentElement.clientWidth - tip.offsetWidth - 8;
  Object.assign(tip.style, { left: `${Math.max(4, Math.min(x + 12, room))}px`, top: `${y + 12}px` });
}

// ---- predicted maps

function showMapsOf(name) {
  if (name in board().gallery.cases) find("#shown-method").value = name;
  drawGallery();
  writeAddress();
  find("#gallery").scrollIntoView();
}

function drawGallery() {
  const { gallery } = board();
  find("#gallery .missing").textContent = gallery.missing;
  const cases = gallery.cases[find("#shown-method").value] ?? [];
  find("#gallery .choice").hidden = !cases.length;
  find("#gallery .choice .note").textContent =
    `${find("#shown-method").value}: best, median and worst by SSIM of a dozen test maps of ${gallery.split}, from easy to hard ones; first seed. Powers down to 30 dB below the peak.`;
  find("#gallery .cases").replaceChildren(...cases.map((each) => caseOf(each, gallery.pictures)));
}

function caseOf(each, pictures) {
  const position = each.tx_position_m.map((metres) => metres.toFixed(2)).join(", ");
  const psnr = each.psnr === null ? "∞" : each.psnr.toFixed(2);
  const said = `transmitter at (${position}) m, ${each.carrier_ghz} GHz, SSIM ${each.ssim.toFixed(4)}, PSNR ${psnr} dB`;
  return element("div", { class: "case" },
    element("p", {}, element("strong", {}, each.place), `: ${said}`),
    mapOf("truth", pictures[each.truth], "power", ["−30 dB", "0 dB"]),
    mapOf("prediction", pictures[each.predicted], "power", ["−30 dB", "0 dB"]),
    mapOf("|difference|", pictures[each.error], "error", ["0", "≥ 0.3"]));
}

function mapOf(title, picture, kind, [low, high]) {
  return element("figure", {},
    element("figcaption", {}, title),
    element("img", { class: "map", alt: `${title}, azimuth to the right, elevation upwards`, src: png(picture) }),
    element("div", { class: "axis" }, element("span", {}, "azimuth 0°"), element("span", {}, "elevation 0° to 90° ↑"), element("span", {}, "360°")),
    element("div", { class: "bar" }, low, element("img", { alt: "", src: png(content.scales[kind]) }), high));
}

const png = (picture) => `data:image/png;base64,${picture}`;

// ---- start

function draw() {
  if (isReading) return;  // once, when all choices are made
  const isEmpty = !shownRows().length;
  find("#none").hidden = !isEmpty;
  find("#charts").hidden = isEmpty;
  if (!isEmpty) drawCharts();
  if (find("#benches")?.open) drawMeasurements();
  offerFigures();
  writeAddress();
}

function drawCharts() {
  find("#charts h2").textContent = `Charts: ${board().title}`;
  drawLegend();
  drawPareto(find("#pareto .panels"));
  drawCurves(find("#curves .panels"));
  drawCarriers(find("#carriers .panels"));
  drawDistributions(find("#cdfs .panels"));
  drawGallery();
}

function whenWidthChanges(action) {
  let width = innerWidth;
  addEventListener("resize", () => { if (innerWidth !== width) { width = innerWidth; action(); } });
}

function tellWidth(box) {
  box.classList.toggle("wide", box.scrollWidth > box.clientWidth);
}

function start() {
  document.documentElement.classList.add("js");
  all(".leaderboard thead th").forEach(makeSortable);
  for (const each of all("table.leaderboard")) each.dataset.order = orderOf(each);  // to which an address may return
  fill(find("#board"), all(".board").map((section) => [section.dataset.board, section.dataset.title]));
  find("#board").addEventListener("change", showBoard);
  find("#set").addEventListener("change", showSet);
  find("#controls").addEventListener("submit", (event) => event.preventDefault());
  find("#filter").addEventListener("input", filterRows);
  find("#families").addEventListener("change", filterRows);
  find("#none button").addEventListener("click", showAllRows);
  find("#every").addEventListener("change", writeAddress);
  find("#cost").addEventListener("change", draw);
  find("#metric").addEventListener("change", draw);
  find("#shown-method").addEventListener("change", () => { drawGallery(); writeAddress(); });
  find("#benches")?.addEventListener("toggle", draw);
  addEventListener("beforeprint", () => find("#benches")?.setAttribute("open", ""));
  offerTables();
  const watched = new ResizeObserver((boxes) => { for (const { target } of boxes) tellWidth(target); });
  for (const box of all(".scroll")) watched.observe(box);
  whenWidthChanges(draw);
  addEventListener("hashchange", readAddress);
  readAddress();
}
