// What happens to one view before matching: smoothing, census, and the penalties of its steps.
// A part of census_kernel_body.hpp.

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
