// What is shown stands in the address, behind its #, so that every board, order and choice has a link.

const CHOICES = { set: "#set", filter: "#filter", cost: "#cost", metric: "#metric", maps: "#shown-method" };
let isReading = false;

const sortedHead = (of) => find("thead [aria-sort]", of);
const headTitle = (head) => find("button", head).textContent;
const orderOf = (of) => (sortedHead(of) ? `${headTitle(sortedHead(of))},${sortedHead(of).getAttribute("aria-sort")}` : "");

function writeAddress() {
  const address = new URLSearchParams();
  for (const [name, selector] of Object.entries(CHOICES)) {
    const { value, options } = find(selector);
    if (value !== (options?.[0]?.value ?? "")) address.set(name, value);
  }
  const hidden = all("#families input:not(:checked)").map((box) => box.value);
  if (hidden.length) address.set("hide", hidden.join(","));
  if (find("#every").checked) address.set("columns", "all");
  if (orderOf(table()) !== table().dataset.order) address.set("sort", orderOf(table()));
  // The page as it opens has no address: a browser that finds one while it loads goes to the place it names.
  const { value, options } = find("#board");
  const said = address.size || value !== options[0].value ? `#${new URLSearchParams([["board", value], ...address])}` : "";
  history.replaceState(null, "", location.pathname + location.search + said);
}

function readAddress() {
  const address = new URLSearchParams(location.hash.slice(1));
  isReading = true;
  choose("#board", address.get("board") ?? find("#board").options[0].value);
  const hidden = (address.get("hide") ?? "").split(",");
  for (const box of all("#families input")) box.checked = !hidden.includes(box.value);
  find("#filter").value = address.get("filter") ?? "";
  find("#every").checked = address.get("columns") === "all";
  showBoard();
  for (const name of ["set", "cost", "metric", "maps"]) choose(CHOICES[name], address.get(name));
  showSet();
  sortAs(address.get("sort") ?? table().dataset.order);
  isReading = false;
  draw();
  if (address.has("board")) find(".board:not([hidden])").scrollIntoView();
}

// A choice of an address that is not among those of the page, as of a page with other results, is passed over.
function choose(selector, value) {
  const select = find(selector);
  if ([...select.options].some((option) => option.value === value)) select.value = value;
}

function sortAs(order) {
  const [title, direction] = [order.replace(/,[a-z]+$/, ""), order.split(",").at(-1)];
  const head = all("thead th", table()).find((each) => headTitle(each) === title);
  if (!head || !["ascending", "descending"].includes(direction)) return;
  sortedHead(table())?.removeAttribute("aria-sort");
  head.setAttribute("aria-sort", direction);
  sortRows(head);
}
