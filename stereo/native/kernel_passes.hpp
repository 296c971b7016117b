// The two passes over the image. A part of census_kernel_body.hpp.

// On to a row that searches so many disparities.
KERNEL_INLINE void search_row(Problem& p, int count, Scratch& s, int phase) {
  const int before = p.disparities;
  if (count == before) return;
  p.disparities = count;
  change_searched(p, before, s, phase);
}

// First pass over a half: rows from `begin` (step +1 or -1) to the middle leave their excesses in
// the volume.
KERNEL_FN void first_pass(const Problem& every, const Searched* searched, const View& left,
                          const View& right, int begin, int end, int step, Scratch& s,
                          u8* volume) {
  Problem p = every.searching(searched[begin].count);
  clear_paths(p, s);
  int phase = 0;
  for (int y = begin; y != end; y += step, phase ^= 1) {
    search_row(p, searched[y].count, s, phase);
    const CensusRow row = census_row(p, left, right, y);
    u8* excess = volume + searched[y].place;
    path_penalties(p, left, y, y == begin ? y : y - step, s, phase);
    for (int i = 0; i < p.columns(); i += kLanes) {
      const int x = phase == 0 ? i : p.columns() - kLanes - i;
      cost_block(p, row, x, s.cost.get());
      u8* out = excess + static_cast<std::ptrdiff_t>(x) * p.disparities;
      const u8* const next = out + (phase == 0 ? kLanes : -kLanes) * p.disparities;
      vertical_block<1>(p, x, s, phase, s.cost.get(), out, &next);
    }
    end_row(p, s, phase);
  }
}

// One row of the second pass: the last vertical paths, then scores and winners block by block.
KERNEL_FN void finish_row(const Problem& p, const CensusRow& row, Scratch& s, int phase,
                          const u8* volume, const u8* horizontal, bool keep_scores,
                          const Winners& w) {
  for (int i = 0; i < p.columns(); i += kLanes) {
    const int x = phase == 0 ? i : p.columns() - kLanes - i;
    const std::size_t block = static_cast<std::size_t>(x) * p.disparities;
    const u8* const ahead[2] = {volume + block, horizontal + block};
    cost_block(p, row, x, s.cost.get());
    vertical_block<2>(p, x, s, phase, s.cost.get(), s.excess.get(), ahead);
    const Addends from = {volume + block, s.excess.get(), horizontal + block, s.cost.get()};
    // without a right view to come, scores are needed no more: they all go to one place
    score_block(p, x, from, s.scores.get() + x, keep_scores ? p.score_stride() : 0, w);
  }
  end_row(p, s, phase);
}

// Second pass: on through the other half, whose excesses are there by now, to the winners.
KERNEL_FN void second_pass(const Problem& every, const Searched* searched, const View& left,
                           const View& right, int begin, int end, int step, int phase, Scratch& s,
                           const u8* volume, Maps maps) {
  if (begin == end) return;
  const bool goes_on = begin - step >= 0 && begin - step < every.height;
  Problem p = every.searching(searched[goes_on ? begin - step : begin].count);
  const Winners w = Winners::in(s.winners.get(), p.columns());
  for (int d = 0; d < p.capacity; ++d)  // what diagonals read right of the last block
    __builtin_memset(s.scores.get() + static_cast<std::size_t>(d) * p.score_stride() + p.columns(),
                     0, kLanes);
  int strip_first = 0, strip_rows = 0;
  for (int y = begin; y != end; y += step, phase ^= 1) {
    search_row(p, searched[y].count, s, phase);
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
               volume + searched[y].place,
               s.strip_sum.get() + static_cast<std::size_t>(y - strip_first) * p.volume_stride(),
               maps.right != nullptr, w);
    const std::size_t row = static_cast<std::size_t>(y) * p.width;
    write_winners(p, w, {maps.left + row, maps.left_margin + row, maps.left_unique + row,
                         1 - p.offset, 1, p.disparities});
    if (maps.right == nullptr) continue;
    for (int x = 0; x < p.columns(); x += kLanes) find_right_winners(p, s.scores.get(), x, w);
    write_winners(p, w, {maps.right + row, maps.right_margin + row, maps.right_unique + row,
                         p.width - p.offset, -1, p.disparities});
  }
}
