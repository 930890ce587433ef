// How the documentation's search orders what it finds: pages whose title has the words first; pages for developers last.
// The other weights are Sphinx's own.
const FOR_DEVELOPERS = ["architecture", "changelog", "contributing"];

var Scorer = {
  score: ([page, title, , , score]) => {
    const query = new URLSearchParams(window.location.search).get("q") || "";
    const stems = (query.toLowerCase().match(/\w{3,}/g) || []).map((word) => word.slice(0, Math.max(4, word.length - 3)));
    const told = stems.filter((stem) => title.toLowerCase().includes(stem)).length;
    return Math.min(score, 20) + 10 * told - (FOR_DEVELOPERS.includes(page) ? 4 : 0);
  },
  objNameMatch: 11,
  objPartialMatch: 6,
  objPrio: { 0: 15, 1: 5, 2: -5 },
  objPrioDefault: 0,
  title: 15,
  partialTitle: 7,
  term: 5,
  partialTerm: 2,
};
