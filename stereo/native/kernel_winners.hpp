// Scores over all paths and the winners of both views. A part of census_kernel_body.hpp.
//
// A score is 255 minus the sum of the weighted cost and of what all paths add, and 0 for larger
// sums and for pixels without a partner: the largest wins.

// What is above `addend`, in a subtraction that stops at zero.
KERNEL_INLINE Bytes without(Bytes score, Bytes addend) {
  return (score > addend ? score : addend) - addend;
}

// The search for the largest score of pixels side by side, over rising disparities.
struct Search {
  Bytes best, at, below, above, second;  // as in Winners
  Bytes last, earlier;                   // the score before, and the best of those before it
  Bytes number, stays;                   // disparity index; ~0 where the last one did not win
};

KERNEL_INLINE void start_search(Search& s) {
  s.best = s.at = s.below = s.above = s.second = s.last = s.earlier = s.number = Bytes{};
  s.stays = ~Bytes{};
}

KERNEL_INLINE void try_next(Search& s, Bytes score) {
  s.above = s.stays != 0 ? s.above : score;
  const Bytes rival = score > s.second ? score : s.second;
  s.second = s.stays != 0 ? rival : s.second;  // a neighbour is no rival
  const Bytes best = score > s.best ? score : s.best;
  s.stays = reinterpret_cast<Bytes>(best == s.best);
  s.at = s.stays != 0 ? s.at : s.number;
  s.below = s.stays != 0 ? s.below : s.last;
  s.second = s.stays != 0 ? s.second : s.earlier;
  s.earlier = s.best;
  s.best = best;
  s.last = score;
  s.number += 1;
}

KERNEL_INLINE void end_search(const Search& s, const Winners& w, int x) {
  store<Bytes>(w.best + x, s.best);
  store<Bytes>(w.at + x, s.at);
  store<Bytes>(w.below + x, s.below);
  store<Bytes>(w.above + x, s.above);
  store<Bytes>(w.second + x, s.second);
}

// Where what a pixel's score consists of lies, disparities x kLanes.
struct Addends {
  const u8 *first, *second, *horizontal, *cost;
};

// Scores of columns [x, x + kLanes), disparities `stride` apart, and the winners of the left view.
template <bool kEdge>
KERNEL_INLINE void score_lanes(const Problem& p, int x, const Addends& from, u8* scores,
                               std::ptrdiff_t stride, const Winners& w) {
  const int weight = p.cost_weight, disparities = p.disparities;
  for (int lane = 0; lane < kLanes; lane += KERNEL_BYTES) {
    u8 columns[KERNEL_BYTES];
    for (int i = 0; i < KERNEL_BYTES; ++i) columns[i] = static_cast<u8>(lane + i);
    const Bytes column = load<Bytes>(columns);
    const int room = p.width - x;
    const u8 inside = static_cast<u8>(room < kLanes ? room : kLanes);
    Search search;
    start_search(search);
    for (int d = 0; d < disparities; ++d) {
      const int at = d * kLanes + lane;
      const Bytes cost = load<Bytes>(from.cost + at);
      Bytes score = without(~load<Bytes>(from.first + at), load<Bytes>(from.second + at));
      score = without(score, load<Bytes>(from.horizontal + at));
      score = without(score, cost);
      for (int i = 1; i < weight; ++i) score = without(score, cost);
      if (kEdge) {
        const int outside = d + p.offset - x;
        const u8 begin = static_cast<u8>(outside < 0 ? 0 : (outside < kLanes ? outside : kLanes));
        score = ((column >= begin) & (column < inside)) ? score : Bytes{};
      }
      store<Bytes>(scores + d * stride + lane, score);
      try_next(search, score);
    }
    end_search(search, w, x + lane);
  }
}

KERNEL_FN void score_block(const Problem& p, int x, const Addends& from, u8* scores,
                           std::ptrdiff_t stride, const Winners& w) {
  if (x < p.offset + p.disparities - 1 || x + kLanes > p.width)
    score_lanes<true>(p, x, from, scores, stride, w);
  else
    score_lanes<false>(p, x, from, scores, stride, w);
}

// Winners of columns [x, x + kLanes) of the right view, whose scores lie on the diagonals
// x = xr + d of the left view's.
KERNEL_FN void find_right_winners(const Problem& p, const u8* scores, int x, const Winners& w) {
  const std::ptrdiff_t step = p.score_stride() + 1;
  const int reach = p.width - p.offset - x;
  const int count = reach < 0 ? 0 : (reach < p.disparities ? reach : p.disparities);
  for (int lane = x; lane < x + kLanes; lane += KERNEL_BYTES) {
    const u8* place = scores + p.offset + lane;
    Search search;
    start_search(search);
    for (int d = 0; d < count; ++d) try_next(search, load<Bytes>(place + d * step));
    end_search(search, w, lane);
  }
}

// Offset of the least sum, -0.5 to 0.5, from how far the sums of the neighbours lie above it. Sums
// of SGM are V-shaped, P1 lifts both sides: a parabola through them stays too near to the whole
// pixel. The equiangular V is right for a V, and u (1.35 - 0.35 u) is what is left to be done at
// smooth surfaces (measured, docs/stereo.md). Integers up to the one division: no build may
// contract or reorder it.
KERNEL_INLINE float fraction_of(Subpixel kind, int below, int above) {
  if (kind == Subpixel::parabola)
    return static_cast<float>(below - above) / static_cast<float>(2 * (below + above));
  const int higher = below > above ? below : above, lower = below > above ? above : below;
  return static_cast<float>((below - above) * (20 * higher + 7 * lower)) /
         static_cast<float>(40 * higher * higher);
}

// Where the results of a row go, and how many disparities a pixel of column x has: what is left of
// first + x * slope, up to `most`.
struct Row {
  float* disparity;
  u8 *margin, *unique;
  int first, slope, most;
};

// Disparity, margin and uniqueness of a row, without branches.
KERNEL_INLINE void write_row(const Winners& w, Subpixel kind, u32 keep, float offset, int width,
                             const Row& row, float* __restrict disparity, u8* __restrict margin,
                             u8* __restrict unique) {
  const u8* __restrict best_at = w.best;
  const u8* __restrict place = w.at;
  const u8* __restrict below_at = w.below;
  const u8* __restrict above_at = w.above;
  const u8* __restrict second = w.second;
  const int first = row.first, slope = row.slope, most = row.most;
  for (int x = 0; x < width; ++x) {
    const int best = 255 - best_at[x], rival = 255 - second[x];
    const int reach = first + slope * x < most ? first + slope * x : most;
    const bool known = reach > 0;
    const int rises = best_at[x] - below_at[x], falls = best_at[x] - above_at[x];
    const int inside = (kind != Subpixel::none) & (place[x] > 0) & (place[x] + 1 < reach) &
                       (rises + falls > 0);
    // equal sums give the fraction 0; a division under a condition would stop the vectoriser
    const int below = (rises & -inside) + (1 - inside);
    const int above = (falls & -inside) + (1 - inside);
    const float fraction = fraction_of(kind, below, above);
    const float unknown = known ? 0.0f : __builtin_nanf("");
    disparity[x] = static_cast<float>(place[x]) + offset + fraction + unknown;
    unique[x] = known & (static_cast<u32>(rival) * keep >= static_cast<u32>(best) * 100u);
    const float share = static_cast<float>(known * 255 * (rival - best)) /
                        static_cast<float>(rival + (rival == 0));
    margin[x] = static_cast<u8>(static_cast<int>(share));
  }
}

KERNEL_FN void write_winners(const Problem& p, const Winners& w, const Row& row) {
  const u32 keep = static_cast<u32>(100 - p.uniqueness_percent);
  const float offset = static_cast<float>(p.offset);
  // one loop for each kind, so that the compiler sees what each does
  if (p.subpixel == Subpixel::equiangular)
    write_row(w, Subpixel::equiangular, keep, offset, p.width, row, row.disparity, row.margin,
              row.unique);
  else if (p.subpixel == Subpixel::parabola)
    write_row(w, Subpixel::parabola, keep, offset, p.width, row, row.disparity, row.margin,
              row.unique);
  else
    write_row(w, Subpixel::none, keep, offset, p.width, row, row.disparity, row.margin, row.unique);
}
