// Vertical and diagonal paths, row by row. A part of census_kernel_body.hpp.

// Path costs of pixels side by side, at d = -1 ... disparities, and what one step of a path needs.
struct Step {
  const u8* old;
  u8* fresh;
  const u8 *minimum, *limit;  // limit = minimum + P2
  u8* new_minimum;
};

// One path while its step runs over the disparities.
template <typename Vector>
struct Path {
  Vector below, same, least, minimum, limit;
  const u8* old;
  u8* fresh;
};

template <typename Vector>
KERNEL_INLINE void start_path(Path<Vector>& path, const Step& step, std::ptrdiff_t stride,
                              int lane) {
  path.old = step.old + lane;
  path.fresh = step.fresh + lane + stride;
  path.minimum = load<Vector>(step.minimum + lane);
  path.limit = load<Vector>(step.limit + lane);
  path.below = load<Vector>(path.old);
  path.same = load<Vector>(path.old + stride);
  path.least = ~Vector{};
  path.old += 2 * stride;
}

// The next disparity: what the path adds to the cost.
template <typename Vector>
KERNEL_INLINE Vector advance(Path<Vector>& path, std::ptrdiff_t stride, Vector p1, Vector cost) {
  const Vector above = load<Vector>(path.old);
  const Vector change = (path.below < above ? path.below : above) + p1;
  const Vector stay = path.same < path.limit ? path.same : path.limit;
  const Vector excess = (stay < change ? stay : change) - path.minimum;
  const Vector path_cost = excess + cost;
  store<Vector>(path.fresh, path_cost);
  path.least = path_cost < path.least ? path_cost : path.least;
  path.below = path.same;
  path.same = above;
  path.old += stride;
  path.fresh += stride;
  return excess;
}

// What becomes of the excesses: nothing, kept, or added to what is there.
enum class Output { none, set, add };

// The step of kCount pixels along kPaths paths at once, from the last pixels to the first if
// `backwards`. `cost` and `out` are disparities x kCount. Meanwhile kAhead blocks that are
// far away and needed soon are fetched, a cache line a disparity: all at once would only queue.
template <typename Vector, int kCount, int kPaths, Output kOutput, int kAhead>
KERNEL_INLINE void follow(const Step* steps, std::ptrdiff_t stride, int disparities, u8 p1,
                          bool backwards, const u8* cost_of_block, u8* out_of_block,
                          const u8* const* ahead) {
  constexpr int kWidth = static_cast<int>(sizeof(Vector));
  for (int part = 0; part < kCount; part += kWidth) {
    const int lane = backwards ? kCount - kWidth - part : part;
    const Vector change = Vector{} + p1;
    const u8* cost = cost_of_block + lane;
    u8* out = kOutput == Output::none ? nullptr : out_of_block + lane;
    Path<Vector> one, two, three;
    start_path(one, steps[0], stride, lane);
    if (kPaths == 3) {
      start_path(two, steps[1], stride, lane);
      start_path(three, steps[2], stride, lane);
    }
    for (std::ptrdiff_t d = 0; d < disparities; ++d) {
      if (kAhead >= 1 && part == 0) __builtin_prefetch(ahead[0] + d * kLanes);
      if (kAhead == 2 && part == 0) __builtin_prefetch(ahead[1] + d * kLanes);
      const Vector here = load<Vector>(cost);
      Vector excess = advance(one, stride, change, here);
      if (kPaths == 3) {
        excess += advance(two, stride, change, here);
        excess += advance(three, stride, change, here);
      }
      cost += kCount;
      if (kOutput == Output::none) continue;
      if (kOutput == Output::add) excess += load<Vector>(out);
      store<Vector>(out, excess);
      out += kCount;
    }
    store<Vector>(steps[0].new_minimum + lane, one.least);
    if (kPaths == 3) {
      store<Vector>(steps[1].new_minimum + lane, two.least);
      store<Vector>(steps[2].new_minimum + lane, three.least);
    }
  }
}

// The path costs of a row replace those of the row before. A row in phase 0 goes from left to right
// and writes what belongs to diagonal paths one block further left than it reads, a row in phase 1
// goes back and writes one block further right: so nothing is overwritten that is still needed, and
// the state takes half of the cache that two rows would.
KERNEL_INLINE int state_column(int dx, int phase) {
  return dx == 0 || phase == 1 ? kLanes : 2 * kLanes;
}

// Which column the predecessor of path k lies in.
KERNEL_INLINE int path_dx(const Problem& p, int k) { return p.vertical_paths == 3 ? k - 1 : 0; }

KERNEL_FN void path_penalties(const Problem& p, const View& view, int y, int from, Scratch& s,
                              int phase) {
  const int stride = p.pixel_stride();
  const u16* here = view.pixels.get() + static_cast<std::size_t>(y) * stride + kLanes;
  const u16* there = view.pixels.get() + static_cast<std::size_t>(from) * stride + kLanes;
  for (int k = 0; k < p.vertical_paths; ++k) {
    const int dx = path_dx(p, k);
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

// Follows the vertical paths into columns [x, x + kLanes) of a row; the sum of their excesses goes
// to `excess`, disparities x kLanes.
template <int kAhead>
KERNEL_FN void vertical_block(const Problem& p, int x, Scratch& s, int phase, const u8* cost,
                              u8* excess, const u8* const* ahead) {
  const int stride = p.pixel_stride();
  u8* minima = s.minima.get() + kLanes + x;
  Step steps[3];
  for (int k = 0; k < p.vertical_paths; ++k) {
    const int dx = path_dx(p, k);
    u8* state = s.paths.get() + k * p.state_size() + x;
    steps[k].old = state + state_column(dx, phase) + dx;
    steps[k].fresh = state + state_column(dx, 1 - phase);
    steps[k].minimum = minima + (phase * 3 + k) * stride + dx;
    steps[k].limit = s.penalties.get() + k * stride + kLanes + x;
    steps[k].new_minimum = minima + ((1 - phase) * 3 + k) * stride;
  }
  const std::ptrdiff_t state_stride = p.state_stride();
  const bool back = phase != 0;
  if (p.vertical_paths == 3)
    follow<Bytes, kLanes, 3, Output::set, kAhead>(steps, state_stride, p.disparities, p.p1, back,
                                                  cost, excess, ahead);
  else
    follow<Bytes, kLanes, 1, Output::set, kAhead>(steps, state_stride, p.disparities, p.p1, back,
                                                  cost, excess, ahead);
}

// What lies beside the image is the predecessor of paths that begin at its edge: zero.
KERNEL_FN void end_row(const Problem& p, Scratch& s, int phase) {
  const std::ptrdiff_t stride = p.state_stride();
  for (int k = 0; k < p.vertical_paths; ++k) {
    u8* fresh = s.paths.get() + k * p.state_size() + state_column(path_dx(p, k), 1 - phase);
    for (int d = 1; d <= p.disparities; ++d)
      fresh[d * stride - 1] = fresh[d * stride + p.width] = 0;
    s.minima.get()[((1 - phase) * 3 + k) * p.pixel_stride() + kLanes + p.width] = 0;
  }
}

// What a row that searches more or fewer disparities than the one before finds of it: nothing of
// those that were not searched there, so that a path gets to them by P2 alone.
KERNEL_FN void change_searched(const Problem& p, int before, Scratch& s, int phase) {
  const std::ptrdiff_t stride = p.state_stride();
  const u8 never = static_cast<u8>(255 - p.p1);
  const int least = before < p.disparities ? before : p.disparities;
  for (int k = 0; k < p.vertical_paths; ++k) {
    u8* state = s.paths.get() + k * p.state_size();
    __builtin_memset(state + (least + 1) * stride, never,
                     static_cast<std::size_t>(p.disparities - least + 1) * stride);
    u8* edge = state + state_column(path_dx(p, k), phase);
    for (int d = before + 1; d <= p.disparities; ++d)
      edge[d * stride - 1] = edge[d * stride + p.width] = 0;
  }
}

KERNEL_FN void clear_paths(const Problem& p, Scratch& s) {
  const std::size_t stride = p.state_stride();
  const u8 never = static_cast<u8>(255 - p.p1);
  for (int k = 0; k < p.vertical_paths; ++k) {
    u8* state = s.paths.get() + k * p.state_size();
    __builtin_memset(state, 0, p.state_size());
    __builtin_memset(state, never, stride);
    __builtin_memset(state + (p.disparities + 1) * stride, never, stride);
  }
  __builtin_memset(s.minima.get(), 0, static_cast<std::size_t>(6) * p.pixel_stride());
}
