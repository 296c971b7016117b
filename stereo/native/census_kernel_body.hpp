// The hot loops of census SGM. Included once for each instruction set, with KERNEL_NAMESPACE and
// KERNEL_TARGET set; plain loops over kLanes bytes that the compiler turns into vectors.
//
// Names: x column, y row, d disparity index (disparity minus offset). A path cost is
//   L(x, d) = C(x, d) + min(L'(d), L'(d-1) + P1, L'(d+1) + P1, m' + P2) - m'
// where L' belongs to the predecessor on the path and m' is its minimum over d. What exceeds C is
// at most P2, so three of these excesses fit one byte (P2 <= 85): that is what the volumes hold.

namespace census {
namespace KERNEL_NAMESPACE {

#define KERNEL_FN KERNEL_TARGET static
#define KERNEL_INLINE KERNEL_TARGET static inline __attribute__((always_inline))

KERNEL_INLINE u8 least(u8 a, u8 b) { return a < b ? a : b; }

#if defined(KERNEL_HAS_BYTE_POPCOUNT)
KERNEL_INLINE u8 hamming(u8 a, u8 b, u8 c) {
  return static_cast<u8>(__builtin_popcount(a) + __builtin_popcount(b) + __builtin_popcount(c));
}
#else
// Counts the bits of three bytes together: a full adder first, then two counts instead of three.
KERNEL_INLINE u8 hamming(u8 a, u8 b, u8 c) {
  const u8 half = a ^ b;
  const u8 ones = half ^ c;
  const u8 twos = (a & b) | (half & c);
  const u8 ones2 = ones - ((ones >> 1) & 0x55);
  const u8 twos2 = twos - ((twos >> 1) & 0x55);
  const u8 ones4 = (ones2 & 0x33) + ((ones2 >> 2) & 0x33);
  const u8 twos4 = (twos2 & 0x33) + ((twos2 >> 2) & 0x33);
  const u8 both = ones4 + twos4 + twos4;
  return (both & 0x0F) + (both >> 4);
}
#endif

// `bit` where the one pixel is darker than the other.
KERNEL_INLINE u16 darker(u16 one, u16 other, u16 bit) {
  return static_cast<u16>(-static_cast<u16>(one < other)) & bit;
}

// One census byte of a row from eight pairs of pixels.
KERNEL_FN void census_byte(const u16* const a[8], const u16* const b[8], int count,
                           u16* __restrict bits, u8* __restrict out) {
  for (int k = 0; k < 8; k += 4) {
    const u16* __restrict a0 = a[k];
    const u16* __restrict a1 = a[k + 1];
    const u16* __restrict a2 = a[k + 2];
    const u16* __restrict a3 = a[k + 3];
    const u16* __restrict b0 = b[k];
    const u16* __restrict b1 = b[k + 1];
    const u16* __restrict b2 = b[k + 2];
    const u16* __restrict b3 = b[k + 3];
    for (int x = 0; x < count; x += kLanes)
      for (int i = x; i < x + kLanes; ++i)
        bits[i] = static_cast<u16>((bits[i] >> 4) | darker(a0[i], b0[i], 16) |
                                   darker(a1[i], b1[i], 32) | darker(a2[i], b2[i], 64) |
                                   darker(a3[i], b3[i], 128));
  }
  for (int x = 0; x < count; x += kLanes)
    for (int i = x; i < x + kLanes; ++i) out[i] = static_cast<u8>(bits[i]);
}

// out = 1 2 1 of three rows, and in place 1 2 1 along a row of which the guards are filled.
KERNEL_INLINE void blend_rows(const u16* __restrict above, const u16* __restrict here,
                              const u16* __restrict below, int shift, int count,
                              u16* __restrict out) {
  for (int i = 0; i < count; ++i)
    out[i] = static_cast<u16>((static_cast<u32>(above[i]) + 2u * here[i] + below[i]) >> shift);
}

KERNEL_INLINE void blend_columns(const u16* __restrict row, int shift, int count,
                                 u16* __restrict out) {
  for (int i = 0; i < count; ++i)
    out[i] = static_cast<u16>(
        (static_cast<u32>(row[i - 1]) + 2u * row[i] + row[i + 1]) >> shift);
}

KERNEL_INLINE int clamp_row(int y, int height) { return y < 0 ? 0 : (y < height ? y : height - 1); }

// Smooths the image in place. Sums keep their fraction as long as 16 bits allow.
KERNEL_FN void smooth(const Problem& p, View& view) {
  if (p.smoothing == Smoothing::none) return;
  const int stride = p.pixel_stride();
  const bool square = p.smoothing == Smoothing::square;
  const int shift = square ? p.smoothing_shift / 2 : p.smoothing_shift;
  u16* image = view.pixels.get();
  u16* columns = view.scratch.get();       // the row that is being made
  u16* above = columns + stride;           // the row above as it was
  __builtin_memcpy(above, image, static_cast<std::size_t>(stride) * sizeof(u16));
  for (int y = 0; y < p.height; ++y) {
    u16* here = image + static_cast<std::size_t>(y) * stride;
    blend_rows(above, here, here + (y + 1 < p.height ? stride : 0), shift, stride, columns);
    __builtin_memcpy(above, here, static_cast<std::size_t>(stride) * sizeof(u16));
    if (!square) {
      __builtin_memcpy(here, columns, static_cast<std::size_t>(stride) * sizeof(u16));
      continue;
    }
    blend_columns(columns + 1, p.smoothing_shift - shift, stride - 2, here + 1);
    for (int x = 0; x < kLanes; ++x) here[x] = here[kLanes];
    for (int x = kLanes + p.width; x < stride; ++x) here[x] = here[kLanes + p.width - 1];
  }
}

// The census of a view; bit k is set where the first pixel of pair k is darker than the second.
KERNEL_FN void census_transform(const Problem& p, View& view) {
  const std::size_t plane = static_cast<std::size_t>(p.height) * p.plane_stride();
  const u16* image = view.pixels.get() + kLanes;
  u16* bits = view.scratch.get();
  const std::ptrdiff_t stride = p.pixel_stride();
  for (int y = 0; y < p.height; ++y) {
    u8* out = view.planes.get() + static_cast<std::size_t>(y) * p.plane_stride() + p.guard();
    for (int j = 0; j < 3; ++j) {
      const u16 *a[8], *b[8];
      for (int k = 0; k < 8; ++k) {
        const Pair& pair = p.pairs[8 * j + k];
        a[k] = image + clamp_row(y + pair.dv_one, p.height) * stride + pair.du_one;
        b[k] = image + clamp_row(y + pair.dv_other, p.height) * stride + pair.du_other;
      }
      __builtin_memset(bits, 0, static_cast<std::size_t>(p.columns()) * sizeof(u16));
      census_byte(a, b, p.columns(), bits, out + j * plane);
    }
  }
}

// P2 for the step from pixel `b` to pixel `a`: it falls with the difference of intensity.
KERNEL_INLINE u8 penalty(const Penalty& p, u16 a, u16 b, u32 cap) {
  u32 step = a > b ? static_cast<u32>(a - b) : static_cast<u32>(b - a);
  step = step < cap ? step : cap;
  const u32 fall = (step * p.alpha_q16) >> 16;
  const u32 room = p.gamma - p.p2_min;
  const u32 left = p.gamma - (fall < room ? fall : room);
  return static_cast<u8>(left < p.p2_max ? left : p.p2_max);
}

KERNEL_INLINE u32 step_cap(const Penalty& p) {
  const u32 cap = p.alpha_q16 == 0 ? 0xFFFFu : 0xFFFFFFFFu / p.alpha_q16;
  return cap < 0xFFFFu ? cap : 0xFFFFu;
}

// Matching costs of one row at one disparity; the cost of pixels without a partner is constant.
KERNEL_INLINE void cost_row(const Problem& p, const u8* const left[3], const u8* const right[3],
                            int d, u8* __restrict cost) {
  const int shift = d + p.offset;
  const u8* __restrict l0 = left[0];
  const u8* __restrict l1 = left[1];
  const u8* __restrict l2 = left[2];
  const u8* __restrict r0 = right[0] - shift;
  const u8* __restrict r1 = right[1] - shift;
  const u8* __restrict r2 = right[2] - shift;
  const int columns = p.columns();
  for (int x = 0; x < columns; x += kLanes)
    for (int i = x; i < x + kLanes; ++i)
      cost[i] = hamming(l0[i] ^ r0[i], l1[i] ^ r1[i], l2[i] ^ r2[i]);
  const int outside = shift < p.width ? shift : p.width;
  for (int x = 0; x < outside; ++x) cost[x] = p.outside_cost;
}

// One vertical path through one row at one disparity. `below`, `same`, `above` are the path costs of
// the predecessors at d-1, d, d+1; `limit` is their minimum + P2. Adds the excess to `sum`.
KERNEL_INLINE void follow_path(const u8* __restrict below, const u8* __restrict same,
                               const u8* __restrict above, const u8* __restrict minimum,
                               const u8* __restrict limit, const u8* __restrict cost, u8 p1,
                               int columns, bool first, u8* __restrict fresh,
                               u8* __restrict new_minimum, u8* __restrict sum) {
  for (int x = 0; x < columns; x += kLanes)
    for (int i = x; i < x + kLanes; ++i) {
      const u8 change = least(below[i], above[i]) + p1;
      const u8 excess = least(least(same[i], change), limit[i]) - minimum[i];
      const u8 path_cost = excess + cost[i];
      fresh[i] = path_cost;
      new_minimum[i] = least(new_minimum[i], path_cost);
      sum[i] = first ? excess : static_cast<u8>(sum[i] + excess);
    }
}

KERNEL_FN void path_penalties(const Problem& p, const View& view, int y, int from, Scratch& s,
                              int phase) {
  const int stride = p.pixel_stride();
  const u16* here = view.pixels.get() + static_cast<std::size_t>(y) * stride + kLanes;
  const u16* there = view.pixels.get() + static_cast<std::size_t>(from) * stride + kLanes;
  for (int k = 0; k < p.vertical_paths; ++k) {
    const int dx = p.vertical_paths == 3 ? k - 1 : 0;
    const Penalty rule = dx == 0 ? p.upright : p.across;
    const u32 cap = step_cap(rule);
    const u16* __restrict other = there + dx;
    const u8* __restrict minimum = s.minima.get() + (phase * 3 + k) * stride + kLanes + dx;
    u8* __restrict limit = s.penalties.get() + k * stride + kLanes;
    for (int x = 0; x < p.columns(); x += kLanes)
      for (int i = x; i < x + kLanes; ++i)
        limit[i] = minimum[i] + penalty(rule, here[i], other[i], cap);
  }
}

// Adds row y to the vertical paths that come from row `from` (y - 1 or y + 1; the first row of a
// pass has state zero, which makes L = C). Writes the sum of excesses to `excess`, a row of
// disparities x columns.
KERNEL_FN void vertical_row(const Problem& p, const View& left, const View& right, int y, int from,
                            Scratch& s, int phase, u8* __restrict excess) {
  const int stride = p.pixel_stride(), columns = p.columns();
  const std::size_t plane = static_cast<std::size_t>(p.height) * p.plane_stride();
  const std::size_t place = static_cast<std::size_t>(y) * p.plane_stride() + p.guard();
  const u8 *l[3], *r[3];
  for (int j = 0; j < 3; ++j) {
    l[j] = left.planes.get() + j * plane + place;
    r[j] = right.planes.get() + j * plane + place;
  }
  path_penalties(p, left, y, from, s, phase);
  u8* __restrict cost = s.cost.get();
  const u8 p1 = p.p1;
  u8* minima = s.minima.get();
  for (int k = 0; k < p.vertical_paths; ++k) {
    u8* fresh = minima + ((1 - phase) * 3 + k) * stride;
    for (int x = 0; x < columns; ++x) fresh[kLanes + x] = 255;
  }
  for (int d = 0; d < p.disparities; ++d) {
    cost_row(p, l, r, d, cost);
    u8* __restrict sum = excess + static_cast<std::size_t>(d) * columns;
    for (int k = 0; k < p.vertical_paths; ++k) {
      const int dx = p.vertical_paths == 3 ? k - 1 : 0;
      const u8* old = (phase ? s.current[k] : s.previous[k]).get() + kLanes;
      const std::size_t row = static_cast<std::size_t>(d + 1) * stride;
      const u8* same = old + row + dx;
      u8* fresh = (phase ? s.previous[k] : s.current[k]).get() + kLanes + row;
      const u8* minimum = minima + (phase * 3 + k) * stride + kLanes + dx;
      const u8* limit = s.penalties.get() + k * stride + kLanes;
      u8* new_minimum = minima + ((1 - phase) * 3 + k) * stride + kLanes;
      if (k == 0)
        follow_path(same - stride, same, same + stride, minimum, limit, cost, p1, columns, true,
                    fresh, new_minimum, sum);
      else
        follow_path(same - stride, same, same + stride, minimum, limit, cost, p1, columns, false,
                    fresh, new_minimum, sum);
      fresh[p.width] = 0;  // outside the image: the predecessor of paths that begin at the edge
    }
  }
  for (int k = 0; k < p.vertical_paths; ++k)
    minima[((1 - phase) * 3 + k) * stride + kLanes + p.width] = 0;
}

KERNEL_FN void clear_paths(const Problem& p, Scratch& s) {
  const int stride = p.pixel_stride();
  const std::size_t size = static_cast<std::size_t>(p.disparities + 2) * stride;
  const std::size_t last = static_cast<std::size_t>(p.disparities + 1) * stride;
  const u8 never = static_cast<u8>(255 - p.p1);
  for (int k = 0; k < p.vertical_paths; ++k)
    for (u8* state : {s.previous[k].get(), s.current[k].get()}) {
      __builtin_memset(state, 0, size);
      __builtin_memset(state, never, stride);
      __builtin_memset(state + last, never, stride);
    }
  __builtin_memset(s.minima.get(), 0, static_cast<std::size_t>(6) * stride);
}

// dst[j][i] = src[i][j] for 16 x 16 bytes: four rounds of interleaving rows i and i + 8.
KERNEL_INLINE void transpose16(const u8* src, std::size_t src_stride, u8* dst,
                               std::size_t dst_stride) {
  Bytes16 a[16], b[16];
  for (int i = 0; i < 16; ++i) __builtin_memcpy(&a[i], src + i * src_stride, 16);
  for (int round = 0; round < 2; ++round) {
    for (int i = 0; i < 8; ++i) {
      b[2 * i] = CENSUS_INTERLEAVE_LOW(a[i], a[i + 8]);
      b[2 * i + 1] = CENSUS_INTERLEAVE_HIGH(a[i], a[i + 8]);
    }
    for (int i = 0; i < 8; ++i) {
      a[2 * i] = CENSUS_INTERLEAVE_LOW(b[i], b[i + 8]);
      a[2 * i + 1] = CENSUS_INTERLEAVE_HIGH(b[i], b[i + 8]);
    }
  }
  for (int i = 0; i < 16; ++i) __builtin_memcpy(dst + i * dst_stride, &a[i], 16);
}

// Rows [y0, y0 + kLanes) of one census plane, columns by rows: out[x][lane].
KERNEL_FN void transpose_rows(const u8* first_row, std::size_t stride, int rows, int columns,
                              u8* out) {
  for (int lane = 0; lane < kLanes; lane += 16)
    for (int x = 0; x < columns; x += 16) {
      u8 tile[16][16];
      for (int i = 0; i < 16; ++i) {
        const int row = lane + i < rows ? lane + i : rows - 1;
        __builtin_memcpy(tile[i], first_row + row * stride + x, 16);
      }
      transpose16(tile[0], 16, out + static_cast<std::size_t>(x) * kLanes + lane, kLanes);
    }
}

// One horizontal path through kLanes rows at one column and disparity, as in follow_path.
KERNEL_INLINE void follow_lanes(const u8* __restrict below, const u8* __restrict same,
                                const u8* __restrict above, const u8* __restrict minimum,
                                const u8* __restrict limit, const u8* __restrict cost, u8 p1,
                                const u8* __restrict add, u8* __restrict fresh,
                                u8* __restrict new_minimum, u8* __restrict sum) {
  for (int i = 0; i < kLanes; ++i) {
    const u8 change = least(below[i], above[i]) + p1;
    const u8 excess = least(least(same[i], change), limit[i]) - minimum[i];
    const u8 path_cost = excess + cost[i];
    fresh[i] = path_cost;
    new_minimum[i] = least(new_minimum[i], path_cost);
    sum[i] = add[i] + excess;
  }
}

KERNEL_INLINE void cost_lanes(const u8* __restrict l0, const u8* __restrict l1,
                              const u8* __restrict l2, const u8* __restrict r0,
                              const u8* __restrict r1, const u8* __restrict r2,
                              u8* __restrict cost) {
  for (int i = 0; i < kLanes; ++i)
    cost[i] = hamming(l0[i] ^ r0[i], l1[i] ^ r1[i], l2[i] ^ r2[i]);
}

// One step of a horizontal path for kLanes rows and all disparities.
KERNEL_FN void horizontal_step(const Problem& p, const u8* const l[3], const u8* const r[3], int x,
                               const u8* old, u8* fresh, const u8* minimum, u8* new_minimum,
                               const u8* p2, const u8* add, u8* out) {
  u8 limit[kLanes], smallest[kLanes], cost[kLanes];
  for (int i = 0; i < kLanes; ++i) {
    limit[i] = minimum[i] + p2[i];
    smallest[i] = 255;
  }
  const std::ptrdiff_t here = static_cast<std::ptrdiff_t>(x) * kLanes;
  const int reach = x - p.offset + 1;
  const int inside = reach < 0 ? 0 : (reach < p.disparities ? reach : p.disparities);
  for (int d = 0; d < p.disparities; ++d) {
    const std::ptrdiff_t there = here - static_cast<std::ptrdiff_t>(d + p.offset) * kLanes;
    if (d < inside)
      cost_lanes(l[0] + here, l[1] + here, l[2] + here, r[0] + there, r[1] + there, r[2] + there,
                 cost);
    else
      __builtin_memset(cost, p.outside_cost, kLanes);
    const u8* same = old + (d + 1) * kLanes;
    follow_lanes(same - kLanes, same, same + kLanes, minimum, limit, cost, p.p1, add + d * kLanes,
                 fresh + (d + 1) * kLanes, smallest, out + d * kLanes);
  }
  __builtin_memcpy(new_minimum, smallest, kLanes);
}

constexpr int kBlockColumns = 32;

// Both horizontal paths of rows [y0, y0 + rows): excesses as s.strip_sum[row][d][x].
KERNEL_FN void horizontal_strip(const Problem& p, const View& left, const View& right, int y0,
                                int rows, Scratch& s) {
  const int columns = p.columns(), stride = p.pixel_stride();
  const std::size_t plane = static_cast<std::size_t>(p.height) * p.plane_stride();
  const std::size_t place = static_cast<std::size_t>(y0) * p.plane_stride() + p.guard();
  const std::size_t turned = static_cast<std::size_t>(columns) * kLanes;
  const u8 *l[3], *r[3];
  for (int j = 0; j < 3; ++j) {
    u8* target = s.strip_planes.get() + 2 * j * turned;
    transpose_rows(left.planes.get() + j * plane + place, p.plane_stride(), rows, columns, target);
    transpose_rows(right.planes.get() + j * plane + place, p.plane_stride(), rows, columns,
                   target + turned);
    l[j] = target;
    r[j] = target + turned;
  }
  // P2 between columns x - 1 and x serves both directions
  const u32 cap = step_cap(p.across);
  u8* by_rows = s.strip_block.get();
  for (int row = 0; row < rows; ++row) {
    const u16* here = left.pixels.get() + static_cast<std::size_t>(y0 + row) * stride + kLanes;
    u8* __restrict target = by_rows + static_cast<std::size_t>(row) * columns;
    for (int x = 0; x < columns; ++x) target[x] = penalty(p.across, here[x], here[x - 1], cap);
  }
  u8* p2 = s.strip_penalty.get();
  transpose_rows(by_rows, columns, rows, columns, p2);

  const std::size_t state = static_cast<std::size_t>(p.disparities + 2) * kLanes;
  // one more cache line a column: columns then fall into different cache sets
  const std::size_t column = static_cast<std::size_t>(p.disparities) * kLanes + kLanes;
  u8* paths[2] = {s.strip_state.get(), s.strip_state.get() + state};
  u8* minimum[2] = {paths[1] + state, paths[1] + state + kLanes};
  u8* nothing = minimum[1] + kLanes;  // disparities x kLanes zeros
  const u8 never = static_cast<u8>(255 - p.p1);

  for (int direction = 0; direction < 2; ++direction) {
    for (u8* path : paths) {
      __builtin_memset(path, 0, state);
      __builtin_memset(path, never, kLanes);
      __builtin_memset(path + state - kLanes, never, kLanes);
    }
    __builtin_memset(minimum[0], 0, kLanes);
    int phase = 0;
    if (direction == 0) {
      for (int x = 0; x < p.width; ++x, phase ^= 1)
        horizontal_step(p, l, r, x, paths[phase], paths[1 - phase], minimum[phase],
                        minimum[1 - phase], p2 + static_cast<std::size_t>(x) * kLanes, nothing,
                        s.strip_first.get() + x * column);
      continue;
    }
    for (int start = (p.width - 1) / kBlockColumns * kBlockColumns; start >= 0;
         start -= kBlockColumns) {
      const int end = start + kBlockColumns < p.width ? start + kBlockColumns : p.width;
      u8* block = s.strip_block.get();
      for (int x = end - 1; x >= start; --x, phase ^= 1)
        horizontal_step(p, l, r, x, paths[phase], paths[1 - phase], minimum[phase],
                        minimum[1 - phase], p2 + static_cast<std::size_t>(x + 1) * kLanes,
                        s.strip_first.get() + x * column, block + (x - start) * column);
      for (int d = 0; d < p.disparities; ++d)
        for (int x = 0; x < kBlockColumns; x += 16)
          for (int lane = 0; lane < kLanes; lane += 16)
            transpose16(block + x * column + static_cast<std::size_t>(d) * kLanes + lane, column,
                        s.strip_sum.get() + lane * p.volume_stride() +
                            static_cast<std::size_t>(d) * columns + start + x,
                        p.volume_stride());
    }
  }
}

// Row of sums over all paths; pixels without a partner get kNoSum.
KERNEL_FN void sum_row(const Problem& p, const View& left, const View& right, int y,
                       const u8* first, const u8* second, const u8* horizontal, Scratch& s) {
  const int columns = p.columns();
  const std::size_t plane = static_cast<std::size_t>(p.height) * p.plane_stride();
  const std::size_t place = static_cast<std::size_t>(y) * p.plane_stride() + p.guard();
  const u8 *l[3], *r[3];
  for (int j = 0; j < 3; ++j) {
    l[j] = left.planes.get() + j * plane + place;
    r[j] = right.planes.get() + j * plane + place;
  }
  for (int d = 0; d < p.disparities; ++d) {
    u8* __restrict cost = s.cost.get();
    cost_row(p, l, r, d, cost);
    const u8* __restrict a = first + static_cast<std::size_t>(d) * columns;
    const u8* __restrict b = second + static_cast<std::size_t>(d) * columns;
    const u8* __restrict c = horizontal + static_cast<std::size_t>(d) * columns;
    i16* __restrict sum = s.sums.get() + static_cast<std::size_t>(d) * p.sum_stride();
    for (int x = 0; x < columns; x += kLanes)
      for (int i = x; i < x + kLanes; ++i)
        sum[i] = static_cast<i16>(a[i] + b[i] + c[i] + cost[i] * p.cost_weight);
    const int outside = d + p.offset < p.width ? d + p.offset : p.width;
    for (int x = 0; x < outside; ++x) sum[x] = kNoSum;
    for (int x = p.width; x < p.sum_stride(); ++x) sum[x] = kNoSum;
  }
}

KERNEL_INLINE void keep_better(const i16* __restrict sum, i16 number, int count,
                               i16* __restrict best, i16* __restrict index) {
  for (int x = 0; x < count; x += kLanes)
    for (int i = x; i < x + kLanes; ++i) {
      index[i] = sum[i] < best[i] ? number : index[i];
      best[i] = sum[i] < best[i] ? sum[i] : best[i];
    }
}

// The best sum that is not a neighbour of the winner.
KERNEL_INLINE void keep_rival(const i16* __restrict sum, i16 number, int count,
                              const i16* __restrict index, i16* __restrict second) {
  for (int x = 0; x < count; x += kLanes)
    for (int i = x; i < x + kLanes; ++i) {
      const i16 distance = static_cast<i16>(number - index[i]);
      const bool near = (distance < 2) & (distance > -2);
      const i16 rival = static_cast<i16>(sum[i] | (-static_cast<i16>(near) & kNoSum));
      second[i] = rival < second[i] ? rival : second[i];
    }
}

// Best disparity of each pixel of one view; sums of the right view lie on the diagonals x = xr + d.
KERNEL_FN void find_winners(const Problem& p, const i16* sums, bool right, i16* best, i16* index,
                            i16* second) {
  for (int x = 0; x < p.columns(); ++x) best[x] = second[x] = kNoSum, index[x] = 0;
  for (int d = 0; d < p.disparities; ++d) {
    const int shift = right ? d + p.offset : 0;
    const int count = p.width > shift ? round_up(p.width - shift, kLanes) : 0;
    keep_better(sums + static_cast<std::size_t>(d) * p.sum_stride() + shift, static_cast<i16>(d),
                count, best, index);
  }
  for (int d = 0; d < p.disparities; ++d) {
    const int shift = right ? d + p.offset : 0;
    const int count = p.width > shift ? round_up(p.width - shift, kLanes) : 0;
    keep_rival(sums + static_cast<std::size_t>(d) * p.sum_stride() + shift, static_cast<i16>(d),
               count, index, second);
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
  const int higher = below > above ? below : above;
  const int step = below - above, size = step < 0 ? -step : step;
  return static_cast<float>(step * (27 * higher - 7 * size)) /
         static_cast<float>(40 * higher * higher);
}

KERNEL_FN void write_winners(const Problem& p, const i16* sums, bool right, const i16* best,
                             const i16* index, const i16* second, float* disparity, u8* margin,
                             u8* unique) {
  const int stride = p.sum_stride();
  const u32 keep = static_cast<u32>(100 - p.uniqueness_percent);
  for (int x = 0; x < p.width; ++x) {
    const u32 b = static_cast<u32>(best[x]), rival = static_cast<u32>(second[x]);
    if (b == kNoSum) {
      disparity[x] = __builtin_nanf("");
      margin[x] = unique[x] = 0;
      continue;
    }
    const int d = index[x];
    float fraction = 0.0f;
    if (p.subpixel != Subpixel::none && d > 0 && d + 1 < p.disparities) {
      const int step = right ? stride + 1 : stride;
      const i16* here = sums + static_cast<std::size_t>(d) * stride + x + (right ? d + p.offset : 0);
      const int below = here[-step], above = here[step];
      if (below != kNoSum && above != kNoSum && below + above > 2 * static_cast<int>(b))
        fraction = fraction_of(p.subpixel, below - static_cast<int>(b), above - static_cast<int>(b));
    }
    disparity[x] = static_cast<float>(d + p.offset) + fraction;
    unique[x] = rival * keep >= b * 100u;
    margin[x] = rival == 0 ? 0
                           : static_cast<u8>(static_cast<float>(255u * (rival - b)) /
                                             static_cast<float>(rival));
  }
}

// First pass over a half: rows from `begin` (step +1 or -1) to the middle leave their excesses in
// the volume.
KERNEL_FN void first_pass(const Problem& p, const View& left, const View& right, int begin, int end,
                          int step, Scratch& s, u8* volume) {
  clear_paths(p, s);
  int phase = 0;
  for (int y = begin; y != end; y += step, phase ^= 1)
    vertical_row(p, left, right, y, y == begin ? y : y - step, s, phase,
                 volume + static_cast<std::size_t>(y) * p.volume_stride());
}

// Second pass: on through the other half, whose excesses are there by now, to the winners.
KERNEL_FN void second_pass(const Problem& p, const View& left, const View& right, int begin,
                           int end, int step, int phase, Scratch& s, const u8* volume, Maps maps) {
  const int lanes = p.columns() + 2 * kLanes;
  i16* w = s.winners.get();
  u8* excess = s.strip_block.get();
  int strip_first = 0, strip_rows = 0;
  for (int y = begin; y != end; y += step, phase ^= 1) {
    if (strip_rows == 0 || y < strip_first || y >= strip_first + strip_rows) {
      const int left_over = (end - y) * step;
      strip_rows = left_over < kLanes ? left_over : kLanes;
      strip_first = step > 0 ? y : y - strip_rows + 1;
      horizontal_strip(p, left, right, strip_first, strip_rows, s);
    }
    // a pass that begins here (an image of one row) has no predecessor
    const int from = y - step;
    const bool outside = from < 0 || from >= p.height;
    vertical_row(p, left, right, y, outside ? y : from, s, phase, excess);
    sum_row(p, left, right, y, volume + static_cast<std::size_t>(y) * p.volume_stride(), excess,
            s.strip_sum.get() + static_cast<std::size_t>(y - strip_first) * p.volume_stride(), s);
    const std::size_t row = static_cast<std::size_t>(y) * p.width;
    find_winners(p, s.sums.get(), false, w, w + lanes, w + 2 * lanes);
    write_winners(p, s.sums.get(), false, w, w + lanes, w + 2 * lanes, maps.left + row,
                  maps.left_margin + row, maps.left_unique + row);
    if (maps.right == nullptr) continue;
    find_winners(p, s.sums.get(), true, w, w + lanes, w + 2 * lanes);
    write_winners(p, s.sums.get(), true, w, w + lanes, w + 2 * lanes, maps.right + row,
                  maps.right_margin + row, maps.right_unique + row);
  }
}

// One row of the left-right check, without branches: what fails is as good as random.
KERNEL_INLINE void check_row(const float* __restrict own, const float* __restrict other,
                             const u8* __restrict unique, int sign, float tolerance, int width,
                             float* __restrict out) {
  for (int x = 0; x < width; ++x) {
    const float d = own[x];
    const float known = d == d ? d : 0.0f;
    const int partner = x + sign * static_cast<int>(known + 0.5f);  // d is not negative
    const bool inside = (partner >= 0) & (partner < width);
    const float difference = other[inside ? partner : x] - d;
    const bool keep = (unique[x] != 0) & inside & (__builtin_fabsf(difference) <= tolerance);
    out[x] = keep ? d : __builtin_nanf("");
  }
}

// Keeps what is unique and what the other view confirms to within `tolerance` (negative: no check).
KERNEL_FN void check_rows(const float* own, const float* other, const u8* unique, float* out,
                          int sign, float tolerance, int width, int height) {
  for (int y = 0; y < height; ++y) {
    const std::size_t row = static_cast<std::size_t>(y) * width;
    if (tolerance >= 0) {
      check_row(own + row, other + row, unique + row, sign, tolerance, width, out + row);
      continue;
    }
    for (int x = 0; x < width; ++x)
      out[row + x] = unique[row + x] != 0 ? own[row + x] : __builtin_nanf("");
  }
}

KERNEL_INLINE void in_order(float& a, float& b) {
  const float low = b < a ? b : a;
  b = b < a ? a : b;
  a = low;
}

KERNEL_FN void median_row(const float* __restrict above, const float* __restrict here,
                          const float* __restrict below, int width, float* __restrict out) {
  for (int x = 1; x < width - 1; ++x) {
    float a = above[x - 1], b = above[x], c = above[x + 1], d = here[x - 1], e = here[x],
          f = here[x + 1], g = below[x - 1], h = below[x], i = below[x + 1];
    const float all = ((a + b) + (c + d)) + ((f + g) + (h + i)) + e;  // NaN where one is
    in_order(b, c), in_order(e, f), in_order(h, i);
    in_order(a, b), in_order(d, e), in_order(g, h);
    in_order(b, c), in_order(e, f), in_order(h, i);
    in_order(a, d), in_order(f, i), in_order(e, h);
    in_order(d, g), in_order(b, e), in_order(c, f);
    in_order(e, h), in_order(e, c), in_order(g, e), in_order(e, c);
    out[x] = all == all ? e : here[x];
  }
}

// 3x3 median of a map; a pixel keeps its value where the window is not complete.
KERNEL_FN void median_rows(const float* source, float* target, int width, int height) {
  for (int y = 0; y < height; ++y) {
    const float* here = source + static_cast<std::size_t>(y) * width;
    float* out = target + static_cast<std::size_t>(y) * width;
    if (y == 0 || y == height - 1 || width < 3) {
      __builtin_memcpy(out, here, static_cast<std::size_t>(width) * sizeof(float));
      continue;
    }
    out[0] = here[0];
    out[width - 1] = here[width - 1];
    median_row(here - width, here, here + width, width, out);
  }
}

#undef KERNEL_FN
#undef KERNEL_INLINE

}  // namespace KERNEL_NAMESPACE
}  // namespace census
