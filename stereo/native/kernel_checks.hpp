// The left-right check and the median.
// A part of census_kernel_body.hpp.

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
