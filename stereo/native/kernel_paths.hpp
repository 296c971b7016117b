// Path costs: vertical and diagonal paths row by row, horizontal paths in strips of kStripRows rows.
// A part of census_kernel_body.hpp.

// One register of path costs.
typedef u8 Bytes __attribute__((vector_size(KERNEL_BYTES)));
// Strips are at most as wide as their number of rows.
constexpr int kStripBytes = KERNEL_BYTES < kStripRows ? KERNEL_BYTES : kStripRows;
typedef u8 StripBytes __attribute__((vector_size(kStripBytes)));

// Copies tell the compilers that the place need not be aligned.
template <typename Vector>
KERNEL_INLINE Vector load(const void* place) {
  Vector value;
  __builtin_memcpy(&value, place, sizeof(Vector));
  return value;
}

template <typename Vector>
KERNEL_INLINE void store(void* place, Vector value) {
  __builtin_memcpy(place, &value, sizeof(Vector));
}

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

template <int kCount>
KERNEL_INLINE void cost_lanes(const u8* __restrict l0, const u8* __restrict l1,
                              const u8* __restrict l2, const u8* __restrict r0,
                              const u8* __restrict r1, const u8* __restrict r2,
                              u8* __restrict cost) {
  for (int i = 0; i < kCount; ++i)
    cost[i] = hamming(l0[i] ^ r0[i], l1[i] ^ r1[i], l2[i] ^ r2[i]);
}

// Matching costs of columns [x, x + kLanes) of one row, disparities x kLanes; the cost of pixels
// without a partner is constant.
KERNEL_FN void cost_block(const Problem& p, const u8* const left[3], const u8* const right[3],
                          int x, u8* cost) {
  for (int d = 0; d < p.disparities; ++d, cost += kLanes) {
    const int shift = d + p.offset, there = x - shift;
    if (shift >= p.width || shift >= x + kLanes) {
      __builtin_memset(cost, p.outside_cost, kLanes);
      continue;
    }
    cost_lanes<kLanes>(left[0] + x, left[1] + x, left[2] + x, right[0] + there, right[1] + there,
                       right[2] + there, cost);
    if (shift > x) __builtin_memset(cost, p.outside_cost, static_cast<std::size_t>(shift - x));
  }
}

// What goes into one step of a path for pixels side by side, and what comes out. `old` and `fresh`
// are path costs at d = -1 ... disparities, `stride` apart; `cost`, `add` and `out` are disparities
// x the number of pixels.
struct Step {
  const u8* old;
  u8* fresh;
  std::ptrdiff_t stride;
  const u8 *cost, *minimum, *limit;  // limit = minimum + P2
  u8* new_minimum;
  const u8* add;
  u8* out;
};

// The step of kCount pixels; `out` gets the excess, or what `add` holds plus the excess.
template <typename Vector, int kCount, bool kAdd>
KERNEL_INLINE void follow(const Step& s, int disparities, u8 p1) {
  for (int lane = 0; lane < kCount; lane += static_cast<int>(sizeof(Vector))) {
    const u8* old = s.old + lane;
    u8* fresh = s.fresh + lane + s.stride;
    const u8* cost = s.cost + lane;
    const u8* add = kAdd ? s.add + lane : nullptr;
    u8* out = s.out + lane;
    const Vector minimum = load<Vector>(s.minimum + lane), limit = load<Vector>(s.limit + lane);
    const Vector step = Vector{} + p1;
    Vector below = load<Vector>(old), same = load<Vector>(old + s.stride), least = ~Vector{};
    old += 2 * s.stride;
    for (int d = 0; d < disparities; ++d) {
      const Vector above = load<Vector>(old);
      const Vector change = (below < above ? below : above) + step;
      const Vector stay = same < limit ? same : limit;
      const Vector excess = (stay < change ? stay : change) - minimum;
      const Vector path_cost = excess + load<Vector>(cost);
      store<Vector>(fresh, path_cost);
      least = path_cost < least ? path_cost : least;
      store<Vector>(out, kAdd ? load<Vector>(add) + excess : excess);
      below = same;
      same = above;
      old += s.stride;
      fresh += s.stride;
      cost += kCount;
      add += kAdd ? kCount : 0;
      out += kCount;
    }
    store<Vector>(s.new_minimum + lane, least);
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

// The census bytes of a row of both views, at column 0.
struct CensusRow {
  const u8 *left[3], *right[3];
};

KERNEL_FN CensusRow census_row(const Problem& p, const View& left, const View& right, int y) {
  const std::size_t plane = static_cast<std::size_t>(p.height) * p.plane_stride();
  const std::size_t place = static_cast<std::size_t>(y) * p.plane_stride() + p.guard();
  CensusRow row;
  for (int j = 0; j < 3; ++j) {
    row.left[j] = left.planes.get() + j * plane + place;
    row.right[j] = right.planes.get() + j * plane + place;
  }
  return row;
}

// Follows the vertical paths into columns [x, x + kLanes) of a row; the sum of their excesses goes
// to `excess`, disparities x kLanes.
KERNEL_FN void vertical_block(const Problem& p, int x, Scratch& s, int phase, const u8* cost,
                              u8* excess) {
  const int stride = p.pixel_stride();
  u8* minima = s.minima.get() + kLanes + x;
  for (int k = 0; k < p.vertical_paths; ++k) {
    const int dx = p.vertical_paths == 3 ? k - 1 : 0;
    Step step;
    step.old = (phase ? s.current[k] : s.previous[k]).get() + kLanes + x + dx;
    step.fresh = (phase ? s.previous[k] : s.current[k]).get() + kLanes + x;
    step.stride = stride;
    step.cost = cost;
    step.minimum = minima + (phase * 3 + k) * stride + dx;
    step.limit = s.penalties.get() + k * stride + kLanes + x;
    step.new_minimum = minima + ((1 - phase) * 3 + k) * stride;
    step.add = step.out = excess;
    if (k == 0)
      follow<Bytes, kLanes, false>(step, p.disparities, p.p1);
    else
      follow<Bytes, kLanes, true>(step, p.disparities, p.p1);
  }
}

// What lies right of the image is the predecessor of paths that begin at its edge: zero.
KERNEL_FN void end_row(const Problem& p, Scratch& s, int phase) {
  const int stride = p.pixel_stride(), edge = kLanes + p.width;
  for (int k = 0; k < p.vertical_paths; ++k) {
    u8* fresh = (phase ? s.previous[k] : s.current[k]).get() + edge;
    for (int d = 1; d <= p.disparities; ++d) fresh[static_cast<std::ptrdiff_t>(d) * stride] = 0;
    s.minima.get()[((1 - phase) * 3 + k) * stride + edge] = 0;
  }
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

// Rows [y0, y0 + kStripRows) of one census plane, columns by rows: out[x][lane].
KERNEL_FN void transpose_rows(const u8* first_row, std::size_t stride, int rows, int columns,
                              u8* out) {
  for (int lane = 0; lane < kStripRows; lane += 16)
    for (int x = 0; x < columns; x += 16) {
      u8 tile[16][16];
      for (int i = 0; i < 16; ++i) {
        const int row = lane + i < rows ? lane + i : rows - 1;
        __builtin_memcpy(tile[i], first_row + row * stride + x, 16);
      }
      transpose16(tile[0], 16, out + static_cast<std::size_t>(x) * kStripRows + lane, kStripRows);
    }
}

// One step of a horizontal path for kStripRows rows, in place; `out` as in follow.
template <bool kAdd>
KERNEL_INLINE void horizontal_step(const Problem& p, const u8* const l[3], const u8* const r[3],
                                   int x, const u8* p2, Scratch& s, const u8* add, u8* out) {
  u8* cost = s.cost.get();
  u8* minimum = s.strip_state.get();
  u8* limit = minimum + kStripRows;
  u8* paths = limit + kStripRows;
  for (int i = 0; i < kStripRows; ++i) limit[i] = static_cast<u8>(minimum[i] + p2[i]);
  const std::ptrdiff_t here = static_cast<std::ptrdiff_t>(x) * kStripRows;
  const int reach = x - p.offset + 1;
  const int inside = reach < 0 ? 0 : (reach < p.disparities ? reach : p.disparities);
  std::ptrdiff_t there = here - static_cast<std::ptrdiff_t>(p.offset) * kStripRows;
  for (int d = 0; d < inside; ++d, there -= kStripRows)
    cost_lanes<kStripRows>(l[0] + here, l[1] + here, l[2] + here, r[0] + there, r[1] + there,
                           r[2] + there, cost + d * kStripRows);
  __builtin_memset(cost + inside * kStripRows, p.outside_cost,
                   static_cast<std::size_t>(p.disparities - inside) * kStripRows);
  follow<StripBytes, kStripRows, kAdd>(
      {paths, paths, kStripRows, cost, minimum, limit, minimum, add, out}, p.disparities, p.p1);
}

// Both horizontal paths of rows [y0, y0 + rows): excesses as rows of a volume in s.strip_sum.
KERNEL_FN void horizontal_strip(const Problem& p, const View& left, const View& right, int y0,
                                int rows, Scratch& s) {
  const int columns = p.columns(), stride = p.pixel_stride();
  const std::size_t plane = static_cast<std::size_t>(p.height) * p.plane_stride();
  const std::size_t place = static_cast<std::size_t>(y0) * p.plane_stride() + p.guard();
  const std::size_t turned = static_cast<std::size_t>(columns) * kStripRows;
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

  // one more cache line a column: columns then fall into different cache sets
  const std::size_t column = static_cast<std::size_t>(p.disparities) * kStripRows + kStripRows;
  const u8 never = static_cast<u8>(255 - p.p1);
  u8* state = s.strip_state.get();  // minimum, limit, path costs at d = -1 ... disparities
  u8* last = state + static_cast<std::size_t>(p.disparities + 3) * kStripRows;
  for (int direction = 0; direction < 2; ++direction) {
    __builtin_memset(state, 0, static_cast<std::size_t>(last - state));
    __builtin_memset(state + 2 * kStripRows, never, kStripRows);
    __builtin_memset(last, never, kStripRows);
    if (direction == 0) {
      for (int x = 0; x < p.width; ++x)
        horizontal_step<false>(p, l, r, x, p2 + static_cast<std::size_t>(x) * kStripRows, s, nullptr,
                               s.strip_first.get() + x * column);
      continue;
    }
    for (int start = (p.width - 1) / kTurned * kTurned; start >= 0;
         start -= kTurned) {
      const int end = start + kTurned < p.width ? start + kTurned : p.width;
      u8* block = s.strip_block.get();
      for (int x = end - 1; x >= start; --x)
        horizontal_step<true>(p, l, r, x, p2 + static_cast<std::size_t>(x + 1) * kStripRows, s,
                              s.strip_first.get() + x * column, block + (x - start) * column);
      u8* target = s.strip_sum.get() + static_cast<std::size_t>(start / kLanes) * kLanes *
                                           p.disparities + start % kLanes;
      for (int d = 0; d < p.disparities; ++d)
        for (int x = 0; x < kTurned; x += 16)
          for (int lane = 0; lane < kStripRows; lane += 16)
            transpose16(block + x * column + static_cast<std::size_t>(d) * kStripRows + lane, column,
                        target + lane * p.volume_stride() +
                            static_cast<std::size_t>(d) * kLanes + x,
                        p.volume_stride());
    }
  }
}
