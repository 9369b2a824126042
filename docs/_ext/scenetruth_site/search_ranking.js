// Ranking of search results: pages that answer a question come first, decisions and the changelog last.
// SEARCH_WORDS has phrases by page; it is written into the search page.

// Words of a question that say nothing about its subject: without this, a page that lacks one of them is not found.
const QUESTION_WORDS =
  "how what which where when why who do does did i my me we our you your can could should would have has am many much need want";
for (const word of QUESTION_WORDS.split(" ")) stopwords.add(word);

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

  // Weight of a word: the fewer pages contain it, the more it says about the page that is wanted.
  weight: (word) => {
    const { terms, titleterms, docnames } = Search._index;
    const pages = (table) => (Object.hasOwn(table, word) ? [table[word]].flat() : []);
    const count = new Set([...pages(terms), ...pages(titleterms)]).size;
    return Math.log((docnames.length + 1) / (count + 0.5));
  },

  weigh: (words) => [...words].reduce((sum, word) => sum + Scorer.weight(word), 0),

  // Share of the words of a query in a text, less for a text with many others.
  cover: (words, text) => {
    const found = Scorer.stems(text);
    const shared = [...words].filter((word) => found.has(word));
    const others = 0.7 + (0.3 * shared.length) / found.size;
    return shared.length ? (Scorer.weigh(shared) / Scorer.weigh(words)) * others : 0;
  },

  // Pages that contain most of the words, by weight, are found too, after those that contain all. A word of a heading
  // counts more than one of the text; the strict search takes the best word of a page for all of its words.
  findByMostWords: () => {
    const find = Search.performTermsSearch;
    Search.performTermsSearch = (words, excluded) => {
      const known = new Map([...words].map((word) => [word, find(new Set([word]), excluded)]));
      const whole = Scorer.weigh([...words].filter((word) => known.get(word).length));
      const pages = new Map();
      for (const [word, results] of known)
        for (const result of results) {
          const page = pages.get(result[0]) || { result: [...result], share: 0, score: 0 };
          const share = Scorer.weight(word) / whole;
          page.share += share;
          page.score += share * result[4];
          pages.set(result[0], page);
        }
      const kept = [...pages.values()].filter(({ share }) => share >= 0.35);
      for (const page of kept) page.result[4] = page.score - 12 * (1 - page.share);
      return kept.map(({ result }) => result);
    };
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

if (typeof Search !== "undefined") Scorer.findByMostWords();
