for (const head of document.querySelectorAll(".rows th")) {
  head.tabIndex = 0;
  head.addEventListener("keydown", (event) => { if (event.key === "Enter") head.click(); });
  head.addEventListener("click", () => {
    const up = head.getAttribute("aria-sort") !== "ascending";
    for (const other of head.parentNode.children) other.removeAttribute("aria-sort");
    head.setAttribute("aria-sort", up ? "ascending" : "descending");
    const body = head.closest("table").tBodies[0];
    const key = (row) => {
      const text = row.cells[head.cellIndex].textContent.replace("−", "-").replace("–", "");
      return isNaN(parseFloat(text)) ? text : parseFloat(text);
    };
    const compare = (a, b) => {
      if (key(a) === "" || key(b) === "") return (key(a) === "") - (key(b) === "");
      const order = isNaN(key(a)) || isNaN(key(b)) ? String(key(a)).localeCompare(key(b)) : key(a) - key(b);
      return up ? order : -order;
    };
    body.append(...[...body.rows].sort(compare));
  });
}
const reveal = () => {
  const target = document.getElementById(location.hash.slice(1));
  for (let part = target; part; part = part.parentElement) if (part.tagName === "DETAILS") part.open = true;
  if (target) target.scrollIntoView({ block: "center" });
};
addEventListener("hashchange", reveal);
reveal();
