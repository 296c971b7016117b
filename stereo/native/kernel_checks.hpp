// The left-right check and the median.
// A part of census_kernel_body.hpp.

// Part of a row of the left-right check, without branches: what fails is as good as random. Three
// loops, since only the middle one, which looks up the partners, has no vector form.
constexpr int kChecked = 256;

KERNEL_INLINE void check_part(const float* __restrict own, const float* __restrict other,
                              const u8* __restrict unique, int first, int sign, float tolerance,
                              int count, int width, float* __restrict out) {
  int partner[kChecked];
  float there[kChecked];
  for (int i = 0; i < count; ++i) {
    const float known = own[i] == own[i] ? own[i] : 0.0f;
    partner[i] = first + i + sign * static_cast<int>(known + 0.5f);  // known is not negative
  }
  for (int i = 0; i < count; ++i)
    there[i] = other[partner[i] < 0 ? 0 : (partner[i] < width ? partner[i] : width - 1)];
  for (int i = 0; i < count; ++i) {
    const bool inside = (partner[i] >= 0) & (partner[i] < width);
    const bool keep = (unique[i] != 0) & inside & (__builtin_fabsf(there[i] - own[i]) <= tolerance);
    out[i] = keep ? own[i] : __builtin_nanf("");
  }
}

KERNEL_INLINE void check_row(const float* own, const float* other, const u8* unique, int sign,
                             float tolerance, int width, float* out) {
  for (int x = 0; x < width; x += kChecked)
    check_part(own + x, other, unique + x, x, sign, tolerance,
               width - x < kChecked ? width - x : kChecked, width, out + x);
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
