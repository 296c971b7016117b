// Matching costs: census bytes of both views to Hamming distances.
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

// Hamming distances of kCount pixels side by side from three census bytes each.
#if defined(KERNEL_HAS_BYTE_POPCOUNT)
template <int kCount>
KERNEL_INLINE void cost_lanes(const u8* __restrict l0, const u8* __restrict l1,
                              const u8* __restrict l2, const u8* __restrict r0,
                              const u8* __restrict r1, const u8* __restrict r2,
                              u8* __restrict cost) {
  for (int i = 0; i < kCount; ++i)
    cost[i] = static_cast<u8>(__builtin_popcount(static_cast<u8>(l0[i] ^ r0[i])) +
                              __builtin_popcount(static_cast<u8>(l1[i] ^ r1[i])) +
                              __builtin_popcount(static_cast<u8>(l2[i] ^ r2[i])));
}
#else
// Words of four pixels: no processor shifts bytes, and no field here outgrows its byte.
typedef u32 Fours __attribute__((vector_size(KERNEL_BYTES)));

// Counts the bits of three bytes together: a full adder first, then two counts instead of three.
KERNEL_INLINE Fours hamming(Fours a, Fours b, Fours c) {
  const Fours half = a ^ b;
  const Fours ones = half ^ c;
  const Fours twos = (a & b) | (half & c);
  const Fours ones2 = ones - ((ones >> 1) & 0x55555555u);
  const Fours twos2 = twos - ((twos >> 1) & 0x55555555u);
  const Fours ones4 = (ones2 & 0x33333333u) + ((ones2 >> 2) & 0x33333333u);
  const Fours twos4 = (twos2 & 0x33333333u) + ((twos2 >> 2) & 0x33333333u);
  const Fours both = ones4 + twos4 + twos4;
  return (both & 0x0F0F0F0Fu) + ((both >> 4) & 0x0F0F0F0Fu);
}

template <int kCount>
KERNEL_INLINE void cost_lanes(const u8* __restrict l0, const u8* __restrict l1,
                              const u8* __restrict l2, const u8* __restrict r0,
                              const u8* __restrict r1, const u8* __restrict r2,
                              u8* __restrict cost) {
  for (int i = 0; i < kCount; i += KERNEL_BYTES)
    store<Fours>(cost + i, hamming(load<Fours>(l0 + i) ^ load<Fours>(r0 + i),
                                   load<Fours>(l1 + i) ^ load<Fours>(r1 + i),
                                   load<Fours>(l2 + i) ^ load<Fours>(r2 + i)));
}
#endif

// Matching costs of kLanes columns of one row for the `count` smallest disparities; the bytes of
// the right view are those of the partners at the first of them.
KERNEL_INLINE void cost_rows(const u8* __restrict l0, const u8* __restrict l1,
                             const u8* __restrict l2, const u8* __restrict r0,
                             const u8* __restrict r1, const u8* __restrict r2,
                             u8* __restrict cost, int count) {
  for (std::ptrdiff_t d = 0; d < count; ++d)
    cost_lanes<kLanes>(l0, l1, l2, r0 - d, r1 - d, r2 - d, cost + d * kLanes);
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

// Matching costs of columns [x, x + kLanes) of one row, disparities x kLanes; the cost of pixels
// without a partner is constant.
KERNEL_FN void cost_block(const Problem& p, const CensusRow& row, int x, u8* cost) {
  const int reach = (x + kLanes < p.width ? x + kLanes : p.width) - p.offset;
  const int inside = reach < 0 ? 0 : (reach < p.disparities ? reach : p.disparities);
  const int there = x - p.offset;
  cost_rows(row.left[0] + x, row.left[1] + x, row.left[2] + x, row.right[0] + there,
            row.right[1] + there, row.right[2] + there, cost, inside);
  for (int d = there < 0 ? 0 : there + 1; d < inside; ++d)
    __builtin_memset(cost + d * kLanes, p.outside_cost, static_cast<std::size_t>(d - there));
  __builtin_memset(cost + inside * kLanes, p.outside_cost,
                   static_cast<std::size_t>(p.disparities - inside) * kLanes);
}
