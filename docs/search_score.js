// How the documentation's search orders what it finds: pages that have the words in their title first, of equals those for users; pages
// for developers last. The other weights are Sphinx's own. A result's title is "PAGE" or "PAGE > SECTION"; names of Python have a description.
const FOR_USERS = [
  "install", "own_scenario", "recording", "tutorial", "own_soft_robot", "own_arm_and_cell", "follow_tip_path", "grasp_an_object",
  "in_the_loop", "speed_and_accuracy", "sweeps", "looking", "results", "snapshots", "failing_runs",
];
const FOR_DEVELOPERS = ["architecture", "changelog", "contributing"];

var Scorer = {
  score: ([page, title, , description, score]) => {
    if (description) return Math.min(score, 20);
    const query = new URLSearchParams(window.location.search).get("q") || "";
    const stems = (query.toLowerCase().match(/\w{3,}/g) || []).map((word) => word.slice(0, Math.max(4, word.length - 3)));
    const told = (text) => stems.filter((stem) => text.toLowerCase().includes(stem)).length;
    const [ofPage, ...ofSection] = title.split(" > ");
    const place = FOR_USERS.includes(page) ? 3 : FOR_DEVELOPERS.includes(page) ? -20 : 0;
    return Math.min(score, 20) + 10 * told(ofPage) + 5 * told(ofSection.join(" ")) + place;
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
