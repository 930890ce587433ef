// What the built documentation's own search finds: node search.cjs HTML_FOLDER QUERY... prints, for each query, pages in order.
const fs = require("fs");
const path = require("path");
const vm = require("vm");

const [folder, ...queries] = process.argv.slice(2);
const nothing = { addEventListener: () => {}, getElementById: () => null, querySelectorAll: () => [] };
const location = { search: "" };
const page = {
  document: { ...nothing, readyState: "loading" },
  location,
  localStorage: { setItem: () => {} },
  SPHINX_HIGHLIGHT_ENABLED: false,
  URLSearchParams,
  _: (text) => text,
  _ready: () => {},
};
page.window = page;
vm.createContext(page);
const scripts = ["_static/searchtools.js", "_static/language_data.js"];
const source = scripts.map((name) => fs.readFileSync(path.join(folder, name), "utf8")).join("\n;\n");
// In the page language_data.js, which holds the scorer, is a script of its own; here it takes the place of the default.
const index = fs.readFileSync(path.join(folder, "searchindex.js"), "utf8");
vm.runInContext(`${source}\n;${index}\n;this.Search = Search;`, page);
for (const query of queries) {
  location.search = `?q=${encodeURIComponent(query)}`;
  const found = page.Search._performSearch(...page.Search._parseQuery(query)).reverse();
  console.log(JSON.stringify(found.map(([name, title, , , score]) => [name, title, score])));
}
