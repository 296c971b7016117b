// Sums over all paths, the winners of both views, and the two passes over the image.
// A part of census_kernel_body.hpp.

// One register of sums.
typedef i16 Words __attribute__((vector_size(KERNEL_BYTES)));
constexpr int kWords = KERNEL_BYTES / 2;

KERNEL_INLINE Words widened(const u8* place) {
  typedef u8 Half __attribute__((vector_size(kWords)));
  return __builtin_convertvector(load<Half>(place), Words);
}

// Sums of columns [x, x + kLanes) over all paths; pixels without a partner get kNoSum.
KERNEL_FN void sum_block(const Problem& p, int x, const u8* first, const u8* second,
                         const u8* horizontal, const u8* cost, i16* sums) {
  const Words weight = Words{} + p.cost_weight;
  for (int d = 0; d < p.disparities; ++d) {
    i16* sum = sums + static_cast<std::size_t>(d) * p.sum_stride() + x;
    for (int i = 0; i < kLanes; i += kWords) {
      const int at = d * kLanes + i;
      store<Words>(sum + i, widened(first + at) + widened(second + at) +
                                widened(horizontal + at) + widened(cost + at) * weight);
    }
    const int outside = d + p.offset - x < kLanes ? d + p.offset - x : kLanes;
    for (int i = 0; i < outside; ++i) sum[i] = kNoSum;
    for (int i = p.width - x; i < kLanes; ++i) sum[i] = kNoSum;
  }
}

// Winners of columns [x, x + kLanes) of one view: least sum, its place, its neighbours, and the
// least sum that is no neighbour. Sums of the right view lie on the diagonals x = xr + d.
KERNEL_FN void find_winners(const Problem& p, const i16* sums, bool right, int x, Winners w) {
  const std::ptrdiff_t step = p.sum_stride() + (right ? 1 : 0);
  int count = p.disparities;
  if (right) {
    const int reach = p.width - p.offset - x;
    count = reach < 0 ? 0 : (reach < count ? reach : count);
    sums += p.offset;
  }
  const Words none = Words{} + kNoSum;
  for (int lane = x; lane < x + kLanes; lane += kWords) {
    const i16* column = sums + lane;
    Words best = none, at = Words{}, below = none, above = none, last = none, won = Words{};
    for (int d = 0; d < count; ++d) {
      const Words sum = load<Words>(column + d * step);
      above = won != 0 ? sum : above;  // the last one is the best so far
      won = sum < best;
      at = won != 0 ? Words{} + static_cast<i16>(d) : at;
      below = won != 0 ? last : below;
      above = won != 0 ? none : above;
      best = sum < best ? sum : best;
      last = sum;
    }
    Words second = none;
    for (int d = 0; d < count; ++d) {
      const Words distance = Words{} + static_cast<i16>(d) - at;
      const Words near = (distance < 2) & (distance > -2);
      const Words rival = load<Words>(column + d * step) | (near & none);
      second = rival < second ? rival : second;
    }
    store<Words>(w.best + lane, best);
    store<Words>(w.at + lane, at);
    store<Words>(w.below + lane, below);
    store<Words>(w.above + lane, above);
    store<Words>(w.second + lane, second);
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

// Disparity, margin and uniqueness of a row, without branches.
KERNEL_INLINE void write_row(const Winners& w, Subpixel kind, u32 keep, float offset, int width,
                             float* __restrict disparity, u8* __restrict margin,
                             u8* __restrict unique) {
  const i16* __restrict best_at = w.best;
  const i16* __restrict place = w.at;
  const i16* __restrict below_at = w.below;
  const i16* __restrict above_at = w.above;
  const i16* __restrict second = w.second;
  for (int x = 0; x < width; ++x) {
    const int best = best_at[x], rival = second[x];
    const bool known = best != kNoSum;
    const int bend = below_at[x] + above_at[x] - 2 * best;
    const int inside = (kind != Subpixel::none) & (below_at[x] != kNoSum) &
                       (above_at[x] != kNoSum) & (bend > 0);
    // equal sums give the fraction 0; a division under a condition would stop the vectoriser
    const int below = ((below_at[x] - best) & -inside) + (1 - inside);
    const int above = ((above_at[x] - best) & -inside) + (1 - inside);
    const float fraction = fraction_of(kind, below, above);
    const float unknown = known ? 0.0f : __builtin_nanf("");
    disparity[x] = static_cast<float>(place[x]) + offset + fraction + unknown;
    unique[x] = known & (static_cast<u32>(rival) * keep >= static_cast<u32>(best) * 100u);
    const float share = static_cast<float>(255 * (rival - best)) /
                        static_cast<float>(rival + (rival == 0));
    margin[x] = static_cast<u8>(static_cast<int>(share));
  }
}

KERNEL_FN void write_winners(const Problem& p, const Winners& w, float* disparity, u8* margin,
                             u8* unique) {
  const u32 keep = static_cast<u32>(100 - p.uniqueness_percent);
  const float offset = static_cast<float>(p.offset);
  // one loop for each kind, so that the compiler sees what each does
  if (p.subpixel == Subpixel::equiangular)
    write_row(w, Subpixel::equiangular, keep, offset, p.width, disparity, margin, unique);
  else if (p.subpixel == Subpixel::parabola)
    write_row(w, Subpixel::parabola, keep, offset, p.width, disparity, margin, unique);
  else
    write_row(w, Subpixel::none, keep, offset, p.width, disparity, margin, unique);
}

// First pass over a half: rows from `begin` (step +1 or -1) to the middle leave their excesses in
// the volume.
KERNEL_FN void first_pass(const Problem& p, const View& left, const View& right, int begin, int end,
                          int step, Scratch& s, u8* volume) {
  clear_paths(p, s);
  int phase = 0;
  for (int y = begin; y != end; y += step, phase ^= 1) {
    const CensusRow row = census_row(p, left, right, y);
    u8* excess = volume + static_cast<std::size_t>(y) * p.volume_stride();
    path_penalties(p, left, y, y == begin ? y : y - step, s, phase);
    for (int x = 0; x < p.columns(); x += kLanes) {
      cost_block(p, row.left, row.right, x, s.cost.get());
      vertical_block(p, x, s, phase, s.cost.get(),
                     excess + static_cast<std::size_t>(x) * p.disparities);
    }
    end_row(p, s, phase);
  }
}

// One row of the second pass: the last vertical paths, then sums and winners block by block.
KERNEL_FN void finish_row(const Problem& p, const CensusRow& row, Scratch& s, int phase,
                          const u8* volume, const u8* horizontal, const Winners& w) {
  for (int x = 0; x < p.columns(); x += kLanes) {
    const std::size_t block = static_cast<std::size_t>(x) * p.disparities;
    for (int d = 0; d < p.disparities; ++d) {  // far away, and needed only after the paths
      __builtin_prefetch(volume + block + d * kLanes);
      __builtin_prefetch(horizontal + block + d * kLanes);
    }
    cost_block(p, row.left, row.right, x, s.cost.get());
    vertical_block(p, x, s, phase, s.cost.get(), s.excess.get());
    sum_block(p, x, volume + block, s.excess.get(), horizontal + block, s.cost.get(),
              s.sums.get());
    find_winners(p, s.sums.get(), false, x, w);
  }
  end_row(p, s, phase);
}

// Second pass: on through the other half, whose excesses are there by now, to the winners.
KERNEL_FN void second_pass(const Problem& p, const View& left, const View& right, int begin,
                           int end, int step, int phase, Scratch& s, const u8* volume, Maps maps) {
  const Winners w = Winners::in(s.winners.get(), p.columns());
  for (int d = 0; d < p.disparities; ++d)  // what diagonals read right of the last block
    for (int x = p.columns(); x < p.sum_stride(); ++x)
      s.sums.get()[static_cast<std::size_t>(d) * p.sum_stride() + x] = kNoSum;
  int strip_first = 0, strip_rows = 0;
  for (int y = begin; y != end; y += step, phase ^= 1) {
    if (strip_rows == 0 || y < strip_first || y >= strip_first + strip_rows) {
      const int left_over = (end - y) * step;
      strip_rows = left_over < kStripRows ? left_over : kStripRows;
      strip_first = step > 0 ? y : y - strip_rows + 1;
      horizontal_strip(p, left, right, strip_first, strip_rows, s);
    }
    // a pass that begins here (an image of one row) has no predecessor
    const int from = y - step;
    path_penalties(p, left, y, from < 0 || from >= p.height ? y : from, s, phase);
    finish_row(p, census_row(p, left, right, y), s, phase,
               volume + static_cast<std::size_t>(y) * p.volume_stride(),
               s.strip_sum.get() + static_cast<std::size_t>(y - strip_first) * p.volume_stride(),
               w);
    const std::size_t row = static_cast<std::size_t>(y) * p.width;
    write_winners(p, w, maps.left + row, maps.left_margin + row, maps.left_unique + row);
    if (maps.right == nullptr) continue;
    for (int x = 0; x < p.columns(); x += kLanes) find_winners(p, s.sums.get(), true, x, w);
    write_winners(p, w, maps.right + row, maps.right_margin + row, maps.right_unique + row);
  }
}
