// Every table can be saved as CSV, and every chart as SVG, without asking any server.

const PAINT = ["fill", "stroke", "stroke-width", "stroke-dasharray", "paint-order", "opacity", "font-family", "font-size", "text-anchor"];

function save(name, kind, text) {
  const link = element("a", { download: name, href: URL.createObjectURL(new Blob([text], { type: kind })) });
  link.click();
  URL.revokeObjectURL(link.href);
}

function saver(text, name, made) {
  const button = element("button", { type: "button", class: "save", title: `Save as ${name}` }, text);
  button.addEventListener("click", () => save(name, text === "CSV" ? "text/csv" : "image/svg+xml", made()));
  return button;
}

// The rows that are shown, in their order; a number is the whole number, not the rounded one that stands in the cell. A
// text that a spreadsheet would compute as a formula gets an apostrophe first.
function csv(table) {
  const heads = [...table.tHead.rows[0].cells].map((cell) => cell.textContent.trim());
  const rows = [...table.tBodies[0].rows].filter((row) => !row.hidden)
    .map((row) => [...row.cells].map((cell) => cell.dataset.value ?? cell.dataset.text ?? cell.textContent.trim()));
  const inert = (text) => (/^[=+\-@\t\r]/.test(text) && Number.isNaN(Number(text)) ? `'${text}` : text);
  const quoted = (text) => (/[",\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text);
  return [heads, ...rows].map((row) => row.map(inert).map(quoted).join(",")).join("\r\n") + "\r\n";
}

// The drawing with the colours of the page's style sheet written into it, so that it stands alone.
function svgText(svg) {
  const copy = svg.cloneNode(true);
  const parts = [svg, ...svg.querySelectorAll("*")];
  [copy, ...copy.querySelectorAll("*")].forEach((part, index) => {
    const style = getComputedStyle(parts[index]);
    for (const property of PAINT) part.setAttribute(property, style.getPropertyValue(property));
    part.removeAttribute("tabindex");
  });
  return new XMLSerializer().serializeToString(copy);
}

const slug = (text) => text.toLowerCase().replace(/[^a-z0-9.]+/g, "-").replace(/^-|-$/g, "");

function offerTables() {
  for (const set of all(".set")) {
    const name = `${set.closest(".board").dataset.board}-${set.dataset.set}.csv`;
    set.append(saver("CSV", name, () => csv(find("table", set))));
  }
  for (const bench of all(".bench"))
    bench.append(saver("CSV", `${slug(find("h3", bench).textContent)}.csv`, () => csv(find("table", bench))));
}

function offerFigures() {
  for (const svg of all(".panels svg")) {
    const owner = svg.closest(".bench") ?? svg.closest("section");
    const place = [find("#board").value, find("h3", owner).textContent, svg.getAttribute("aria-label")];
    svg.after(saver("SVG", `${slug(place.filter(Boolean).join("-"))}.svg`, () => svgText(svg)));
  }
}
