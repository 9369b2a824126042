// Ranking of search results: pages that answer a question come first, decisions and the changelog last.
// SEARCH_WORDS has phrases by page; it is written into the search page.
var Scorer = {
  objNameMatch: 11,
  objPartialMatch: 6,
  objPrio: { 0: 15, 1: 5, 2: -5 },
  objPrioDefault: 0,
  title: 15,
  partialTitle: 7,
  term: 5,
  partialTerm: 2,

  last: /^(changelog|explanation\/decisions\/)/,
  places: [
    [/^reference\/api\//, -12],
    [/^results\/worked_examples\//, -6],
    [/^results\//, -2],
    [/^(get_started|index|how_to|tutorials)/, 3],
  ],

  stems: (text) => {
    const stemmer = new Stemmer();
    const words = (text || "").toLowerCase().split(/[^\p{Letter}\p{Number}_]+/u);
    const kept = words.filter((word) => word && !stopwords.has(word));
    return new Set(kept.map((word) => stemmer.stemWord(word)));
  },

  query: () => new URLSearchParams(window.location.search).get("q"),

  // Share of the words of a query in a text, less for a text with many others.
  cover: (words, text) => {
    const found = Scorer.stems(text);
    const shared = [...words].filter((word) => found.has(word)).length;
    return words.size && found.size ? (shared / words.size) * (0.7 + (0.3 * shared) / found.size) : 0;
  },

  score: (result) => {
    const [page, , , , score] = result;
    const words = Scorer.stems(Scorer.query());
    const title = Search._index.titles[Search._index.docnames.indexOf(page)];
    const phrases = typeof SEARCH_WORDS === "undefined" ? [] : SEARCH_WORDS[page] || [];
    const place = Scorer.places.find(([pattern]) => pattern.test(page));
    const bonus = 15 * Scorer.cover(words, title) + 40 * Math.max(0, ...phrases.map((text) => Scorer.cover(words, text) ** 2));
    return score + bonus + (place ? place[1] : 0) - (Scorer.last.test(page) ? 1000 : 0);
  },
};
