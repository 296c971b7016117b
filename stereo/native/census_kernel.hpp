// What the three builds of the hot loops (baseline, AVX2, AVX-512) have in common.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <memory>
#include <new>

#if defined(__linux__)
#include <sys/mman.h>
#endif

namespace census {

using u8 = std::uint8_t;
using u16 = std::uint16_t;
using u32 = std::uint32_t;

// Every inner loop runs over this many bytes: one AVX-512 register, two of AVX2, four of SSE2.
constexpr int kLanes = 64;
// Horizontal paths run over so many rows at once: few enough that what the first direction leaves
// for the second stays in the cache.
constexpr int kStripRows = 32;
constexpr int kTurned = 32;  // columns that are turned into rows together

// The compilers' portable shuffle, for the transposition of bytes only: no loop expresses it.
#if defined(__clang__) || __GNUC__ >= 12
#define CENSUS_SHUFFLE(Vector, a, b, ...) __builtin_shufflevector(a, b, __VA_ARGS__)
#else
#define CENSUS_SHUFFLE(Vector, a, b, ...) __builtin_shuffle(a, b, Vector{__VA_ARGS__})
#endif

constexpr int round_up(int value, int step) { return (value + step - 1) / step * step; }

// Zero-filled memory on a cache line. Large blocks ask for huge pages: the volumes are read with
// large strides, and small pages would cost a page-table walk a read.
template <typename T>
class Buffer {
 public:
  void resize(std::size_t count) {
    if (count <= count_) return;
    const std::size_t page = count * sizeof(T) >= (1u << 20) ? (2u << 20) : 64u;
    const std::size_t bytes = (count * sizeof(T) + page - 1) / page * page;
    void* memory = std::aligned_alloc(page, bytes);
    if (memory == nullptr) throw std::bad_alloc();
#if defined(__linux__) && defined(MADV_HUGEPAGE)
    if (page > 64) madvise(memory, bytes, MADV_HUGEPAGE);
#endif
    __builtin_memset(memory, 0, bytes);
    data_.reset(static_cast<T*>(memory));
    count_ = count;
  }
  T* get() const { return data_.get(); }
  std::size_t count() const { return count_; }

 private:
  struct Free {
    void operator()(T* memory) const { std::free(memory); }
  };
  std::unique_ptr<T, Free> data_;
  std::size_t count_ = 0;
};

// Two pixels that one census bit compares, as offsets from the pixel that it describes.
struct Pair {
  int dv_one, du_one, dv_other, du_other;
};

// 1 2 1 sums of the image before anything else: none, over rows (up and down), or over both.
enum class Smoothing { none, upright, square };

// Where between two disparities the least sum lies.
enum class Subpixel { none, parabola, equiangular };

// P2 of a step between two pixels: gamma - alpha * |step of intensity|, at least p2_min.
struct Penalty {
  u32 p2_min, p2_max, gamma, alpha_q16;
};

// How many disparities a row searches, and where its excesses lie in the volume.
struct Searched {
  int count;
  std::size_t place;
};

// Sizes, penalties and where things lie in memory. Rows of pixels are padded to whole blocks of
// kLanes, with guards on both sides that the diagonal paths and the shifted right view may read.
struct Problem {
  int width, height;
  int disparities, offset;  // searched: offset ... offset + disparities - 1
  int capacity;             // the most that any row searches
  int vertical_paths;       // 1 (4 paths in all) or 3 (8 paths)
  int uniqueness_percent;
  int cost_weight;          // how often the matching cost itself counts beside the excesses
  u8 p1, outside_cost;
  Subpixel subpixel;
  Pair pairs[24];
  Smoothing smoothing;
  int smoothing_shift;      // bits dropped after it, so that 16 hold the sum
  Penalty across, upright;  // of horizontal and diagonal steps, and of vertical ones

  // The same where fewer disparities are searched.
  Problem searching(int count) const {
    Problem other = *this;
    other.disparities = count;
    return other;
  }

  int paths() const { return 2 * vertical_paths + 2; }
  int columns() const { return round_up(width, kLanes); }
  int guard() const { return round_up(capacity + offset, kLanes) + kLanes; }
  int plane_stride() const { return guard() + columns() + kLanes; }
  // an odd number of cache lines, so that the rows of a state do not share cache sets
  int pixel_stride() const { return ((columns() / kLanes + 2) | 1) * kLanes; }
  int score_stride() const { return columns() + kLanes; }
  // of the path costs of a row: a block of zeros left of the image, one of slack, guards
  int state_stride() const { return ((columns() / kLanes + 3) | 1) * kLanes; }
  std::size_t state_size() const {
    return static_cast<std::size_t>(capacity + 2) * state_stride();
  }
  std::size_t strip_column() const {
    return static_cast<std::size_t>(disparities + 1) * kStripRows;
  }
  std::size_t strip_state_size() const {
    return static_cast<std::size_t>(disparities + 4) * kStripRows;
  }
  // an odd number of cache lines a row, so that rows do not fall into the same cache sets
  std::size_t volume_stride() const {
    return static_cast<std::size_t>(disparities) * columns() + kLanes;
  }
};

// One image: intensities (rows of pixel_stride, first pixel at kLanes) and the three census bytes
// (planes of rows of plane_stride, first pixel at guard).
struct View {
  Buffer<u16> pixels;  // smoothed in place of the image that came in
  Buffer<u16> scratch;
  Buffer<u8> planes;
};

// Sums of path costs above the matching cost that the other half leaves behind: one byte each.
struct Volume {
  Buffer<u8> bytes;
};

// What one thread needs for its half of the image.
struct Scratch {
  Buffer<u8> paths;          // path costs of a row, see state_column; three of state_size
  Buffer<u8> minima;         // 2 x 3 x pixel_stride
  Buffer<u8> penalties;      // 3 x pixel_stride: minimum + P2
  Buffer<u8> cost, excess;   // of one block, disparities x kLanes
  Buffer<u8> scores;         // disparities x score_stride
  Buffer<u8> winners;        // five rows, see Winners
  Buffer<u8> strip_planes;   // census bytes of a strip, columns by rows
  Buffer<u8> strip_penalty;
  Buffer<u8> strip_states;   // path from the left at every kTurned columns, path from the right
  Buffer<u8> strip_block;    // kTurned columns: excesses, then costs
  Buffer<u8> strip_sum;      // both horizontal paths of a strip, by rows
};

// Of each pixel of a row: the largest score, its disparity index, the scores beside it, and the
// largest score that is no neighbour.
struct Winners {
  u8 *best, *at, *below, *above, *second;

  static Winners in(u8* memory, int columns) {
    return {memory, memory + columns, memory + 2 * columns, memory + 3 * columns,
            memory + 4 * columns};
  }
};

struct Maps {
  float *left, *right;              // every winner, NaN where no partner lies in the image
  u8 *left_margin, *right_margin;   // 255 (second - best) / second
  u8 *left_unique, *right_unique;   // 1 where the winner passes the uniqueness test
};

}  // namespace census
