// Horizontal paths, in strips of kStripRows rows. A part of census_kernel_body.hpp.

// The low and the high halves of two registers, byte by byte in turn, each 16 bytes by themselves.
typedef u8 Bytes16 __attribute__((vector_size(16)));

KERNEL_INLINE Bytes16 interleave_low(Bytes16 a, Bytes16 b) {
  return CENSUS_SHUFFLE(Bytes16, a, b, 0, 16, 1, 17, 2, 18, 3, 19, 4, 20, 5, 21, 6, 22, 7, 23);
}

KERNEL_INLINE Bytes16 interleave_high(Bytes16 a, Bytes16 b) {
  return CENSUS_SHUFFLE(Bytes16, a, b, 8, 24, 9, 25, 10, 26, 11, 27, 12, 28, 13, 29, 14, 30, 15,
                        31);
}

#if KERNEL_BYTES >= 32
KERNEL_INLINE StripBytes interleave_low(StripBytes a, StripBytes b) {
  return CENSUS_SHUFFLE(StripBytes, a, b, 0, 32, 1, 33, 2, 34, 3, 35, 4, 36, 5, 37, 6, 38, 7, 39,
                        16, 48, 17, 49, 18, 50, 19, 51, 20, 52, 21, 53, 22, 54, 23, 55);
}

KERNEL_INLINE StripBytes interleave_high(StripBytes a, StripBytes b) {
  return CENSUS_SHUFFLE(StripBytes, a, b, 8, 40, 9, 41, 10, 42, 11, 43, 12, 44, 13, 45, 14, 46, 15,
                        47, 24, 56, 25, 57, 26, 58, 27, 59, 28, 60, 29, 61, 30, 62, 31, 63);
}
#endif

// Turns 16 rows of 16 bytes, or of twice 16: dst[j][i] = src[i][j]. Four rounds that interleave
// rows i and i + 8.
template <typename Vector>
KERNEL_INLINE void transpose(const u8* src, std::size_t src_stride, u8* dst,
                             std::size_t dst_stride) {
  Vector a[16], b[16];
  for (int i = 0; i < 16; ++i) a[i] = load<Vector>(src + i * src_stride);
  for (int round = 0; round < 2; ++round) {
    for (int i = 0; i < 8; ++i) {
      b[2 * i] = interleave_low(a[i], a[i + 8]);
      b[2 * i + 1] = interleave_high(a[i], a[i + 8]);
    }
    for (int i = 0; i < 8; ++i) {
      a[2 * i] = interleave_low(b[i], b[i + 8]);
      a[2 * i + 1] = interleave_high(b[i], b[i + 8]);
    }
  }
  for (int i = 0; i < 16; ++i) {
    u8 rows[sizeof(Vector)];
    store<Vector>(rows, a[i]);
    for (std::size_t j = 0; j < sizeof(Vector); j += 16)
      __builtin_memcpy(dst + (i + j) * dst_stride, rows + j, 16);
  }
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
      transpose<Bytes16>(tile[0], 16, out + static_cast<std::size_t>(x) * kStripRows + lane,
                         kStripRows);
    }
}

// The rows of a strip, columns by rows.
struct Strip {
  const u8 *left[3], *right[3];  // census bytes
  const u8* p2;                  // of the step between columns x - 1 and x
};

// A path that runs through a strip: minimum, limit, path costs at d = -1 ... disparities.
KERNEL_INLINE void start_horizontal(const Problem& p, u8* state) {
  const u8 never = static_cast<u8>(255 - p.p1);
  __builtin_memset(state, 0, p.strip_state_size());
  __builtin_memset(state + 2 * kStripRows, never, kStripRows);
  __builtin_memset(state + (p.disparities + 3) * kStripRows, never, kStripRows);
}

template <Output kOutput>
KERNEL_FN void horizontal_step(const Problem& p, const u8* p2, u8* state, const u8* cost, u8* out,
                               const u8* ahead) {
  u8* minimum = state;
  u8* limit = state + kStripRows;
  u8* paths = state + 2 * kStripRows;
  for (int i = 0; i < kStripRows; ++i) limit[i] = static_cast<u8>(minimum[i] + p2[i]);
  const Step step = {paths, paths, minimum, limit, minimum};
  constexpr int kAhead = kOutput == Output::add ? 1 : 0;
  follow<StripBytes, kStripRows, 1, kOutput, kAhead>(&step, kStripRows, p.disparities, p.p1, false,
                                                     cost, out, &ahead);
}

// Matching costs of column x of a strip, disparities x kStripRows.
KERNEL_FN void strip_costs(const Problem& p, const Strip& strip, int x, u8* __restrict cost) {
  const int reach = x - p.offset + 1;
  const int inside = reach < 0 ? 0 : (reach < p.disparities ? reach : p.disparities);
  const std::ptrdiff_t here = static_cast<std::ptrdiff_t>(x) * kStripRows;
  const std::ptrdiff_t there = here - static_cast<std::ptrdiff_t>(p.offset) * kStripRows;
  const u8* __restrict l0 = strip.left[0] + here;
  const u8* __restrict l1 = strip.left[1] + here;
  const u8* __restrict l2 = strip.left[2] + here;
  const u8* __restrict r0 = strip.right[0] + there;
  const u8* __restrict r1 = strip.right[1] + there;
  const u8* __restrict r2 = strip.right[2] + there;
  for (std::ptrdiff_t d = 0; d < inside * kStripRows; d += kStripRows)
    cost_lanes<kStripRows>(l0, l1, l2, r0 - d, r1 - d, r2 - d, cost + d);
  __builtin_memset(cost + inside * kStripRows, p.outside_cost,
                   static_cast<std::size_t>(p.disparities - inside) * kStripRows);
}

// Turns census bytes and penalties of rows [y0, y0 + rows) into columns by rows.
KERNEL_FN Strip turn_strip(const Problem& p, const View& left, const View& right, int y0, int rows,
                           Scratch& s) {
  const int columns = p.columns(), stride = p.pixel_stride();
  const std::size_t plane = static_cast<std::size_t>(p.height) * p.plane_stride();
  const std::size_t place = static_cast<std::size_t>(y0) * p.plane_stride() + p.guard();
  const std::size_t turned = static_cast<std::size_t>(columns) * kStripRows;
  Strip strip;
  for (int j = 0; j < 3; ++j) {
    u8* target = s.strip_planes.get() + 2 * j * turned;
    transpose_rows(left.planes.get() + j * plane + place, p.plane_stride(), rows, columns, target);
    transpose_rows(right.planes.get() + j * plane + place, p.plane_stride(), rows, columns,
                   target + turned);
    strip.left[j] = target;
    strip.right[j] = target + turned;
  }
  const u32 cap = step_cap(p.across);
  u8* by_rows = s.strip_block.get();
  for (int row = 0; row < rows; ++row) {
    const u16* here = left.pixels.get() + static_cast<std::size_t>(y0 + row) * stride + kLanes;
    u8* __restrict target = by_rows + static_cast<std::size_t>(row) * columns;
    for (int x = 0; x < columns; ++x) target[x] = penalty(p.across, here[x], here[x - 1], cap);
  }
  transpose_rows(by_rows, columns, rows, columns, s.strip_penalty.get());
  strip.p2 = s.strip_penalty.get();
  return strip;
}

// Turns kTurned columns of a strip into rows of a volume.
KERNEL_FN void turn_block(const Problem& p, const u8* block, u8* target) {
  const std::size_t column = p.strip_column(), stride = p.volume_stride();
  for (int d = 0; d < p.disparities; ++d, block += kStripRows, target += kLanes)
    for (int x = 0; x < kTurned; x += 16)
      for (int lane = 0; lane < kStripRows; lane += kStripBytes)
        transpose<StripBytes>(block + x * column + lane, column, target + lane * stride + x,
                              stride);
}

// Both horizontal paths of rows [y0, y0 + rows): excesses as rows of a volume in s.strip_sum.
// What the path from the left adds would not fit the cache for a whole strip. So the path leaves
// its state at every kTurned columns, and goes through them again just before the path from the
// right does.
KERNEL_FN void horizontal_strip(const Problem& p, const View& left, const View& right, int y0,
                                int rows, Scratch& s) {
  const Strip strip = turn_strip(p, left, right, y0, rows, s);
  // one more cache line a column: columns then fall into different cache sets
  const std::size_t column = p.strip_column();
  const std::size_t size = p.strip_state_size();
  const int last = (p.width - 1) / kTurned * kTurned;
  u8* rightward = s.strip_states.get();  // one state at the left of each kTurned columns
  u8* leftward = rightward + (last / kTurned + 1) * size;
  u8* block = s.strip_block.get();
  u8* costs = block + kTurned * column;
  start_horizontal(p, rightward);
  for (int x = 0; x < last; ++x) {
    if (x % kTurned == 0) {
      __builtin_memcpy(rightward + size, rightward, size);
      rightward += size;
    }
    strip_costs(p, strip, x, costs);
    horizontal_step<Output::none>(p, strip.p2 + x * kStripRows, rightward, costs, nullptr, nullptr);
  }
  start_horizontal(p, leftward);
  for (int start = last; start >= 0; start -= kTurned, rightward -= size) {
    const int end = start + kTurned < p.width ? start + kTurned : p.width;
    for (int x = start; x < end; ++x) {
      const std::size_t at = (x - start) * column;
      strip_costs(p, strip, x, costs + at);
      horizontal_step<Output::set>(p, strip.p2 + x * kStripRows, rightward, costs + at, block + at,
                                   nullptr);
    }
    u8* target = s.strip_sum.get() +
                 static_cast<std::size_t>(start / kLanes) * kLanes * p.disparities + start % kLanes;
    for (int x = end - 1; x >= start; --x) {
      const std::size_t at = (x - start) * column;
      const u8* ahead = target + (x - start) % kStripRows * p.volume_stride();
      horizontal_step<Output::add>(p, strip.p2 + (x + 1) * kStripRows, leftward, costs + at,
                                   block + at, ahead);
    }
    turn_block(p, block, target);
  }
}
