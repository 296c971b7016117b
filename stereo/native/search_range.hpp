// How many disparities each row is to search, from the pair at an eighth of its size.
#pragma once

#include <algorithm>
#include <vector>

#include "aggregation.hpp"
#include "disparity_checks.hpp"

namespace census {

// First row of the strip that row y lies in: strips lie as the second pass meets them, from the
// middle outwards.
inline int strip_of(int y, int height) {
  const int middle = height / 2;
  if (y >= middle) return middle + (y - middle) / kStripRows * kStripRows;
  return middle - 1 - (middle - 1 - y) / kStripRows * kStripRows;
}

// What is near is wide and stands upright, so that the pair at half its width and a quarter of its
// height shows it. Disparities beyond the largest that a strip of rows holds there are not searched
// at full size.
class SearchRange {
 public:
  // A count for each row, the same for all rows of a horizontal strip.
  template <typename T>
  std::vector<int> rows(const Problem& p, const Loops& loops, const T* left, const T* right,
                        bool threads) {
    std::vector<int> searched(static_cast<std::size_t>(p.height), p.disparities);
    if (p.disparities <= kWorthIt || p.width < kLeast * kAcross || p.height < kLeast * kDown)
      return searched;
    const Problem small = shrunk(p);
    const std::size_t size = static_cast<std::size_t>(small.width) * small.height;
    std::vector<T>& one = images<T>(0);
    std::vector<T>& two = images<T>(1);
    for (Buffer<float>& map : maps_) map.resize(size);
    for (Buffer<u8>& map : marks_) map.resize(size);
    run_together({[&] { shrink(p, left, one); }, [&] { shrink(p, right, two); }}, threads);
    const std::vector<int> all(static_cast<std::size_t>(small.height), small.disparities);
    aggregation_.run(small, all, loops, one.data(), two.data(), false, threads,
                     {maps_[0].get(), maps_[1].get(), marks_[0].get(), marks_[1].get(),
                      marks_[2].get(), marks_[3].get()});
    loops.check_rows(maps_[0].get(), maps_[1].get(), marks_[2].get(), maps_[2].get(), -1,
                     kTolerance, small.width, small.height);
    speckles_.run(maps_[2].get(), small.width, small.height, kSpecklePx, kSpeckleRows,
                  kSpeckleStep);
    std::vector<int> shown(searched.size());
    for (int y = 0; y < p.height; ++y)
      shown[y] = strip_of(y, p.height) == y ? count_of(p, small, y) : 0;
    // what stands in a strip may reach into the one beside it
    for (int y = 0; y < p.height; ++y) {
      int& count = searched[y] = shown[strip_of(y, p.height)];
      for (const int other : {y - kStripRows, y + kStripRows}) {
        const int row = std::clamp(other, 0, p.height - 1);
        count = std::max(count, shown[strip_of(row, p.height)]);
      }
    }
    return searched;
  }

 private:
  static constexpr int kAcross = 2, kDown = 4;  // how much smaller
  static constexpr int kLeast = 32;             // pixels across and down that are worth it
  static constexpr int kSearchedAlways = 48;    // what is farther may be thinner than a small pixel
  static constexpr int kWorthIt = 64;           // with fewer disparities there is little to save
  static constexpr int kStep = 8, kMargin = 8;  // counts are multiples, beyond what is found
  static constexpr int kVotes = 6;              // so many small pixels must hold a disparity
  static constexpr int kSpecklePx = 25, kSpeckleRows = 4;
  static constexpr float kSpeckleStep = 1.0f, kTolerance = 1.0f;

  static Problem shrunk(const Problem& p) {
    Problem small = p;
    small.width = p.width / kAcross;
    small.height = p.height / kDown;
    small.offset = p.offset / kAcross;
    small.disparities = (p.offset + p.disparities - 1) / kAcross - small.offset + 1;
    small.capacity = small.disparities;
    small.vertical_paths = 1;
    small.subpixel = Subpixel::none;
    small.uniqueness_percent = 0;
    return small;
  }

  // Means of kDown x kAcross pixels.
  template <typename T>
  static void shrink(const Problem& p, const T* image, std::vector<T>& out) {
    const int width = p.width / kAcross, height = p.height / kDown;
    out.resize(static_cast<std::size_t>(width) * height);
    std::vector<u32> sums(static_cast<std::size_t>(p.width));
    for (int y = 0; y < height; ++y) {
      const T* row = image + static_cast<std::size_t>(y) * kDown * p.width;
      for (int x = 0; x < width * kAcross; ++x)
        sums[x] = static_cast<u32>(row[x]) + row[x + p.width] + row[x + 2 * p.width] +
                  row[x + 3 * p.width];
      T* target = out.data() + static_cast<std::size_t>(y) * width;
      for (int x = 0; x < width; ++x)
        target[x] = static_cast<T>((sums[2 * x] + sums[2 * x + 1] + 4) >> 3);
    }
  }

  // What the strip from row `first` on, downwards or upwards, is to search.
  int count_of(const Problem& p, const Problem& small, int first) const {
    const int step = first >= p.height / 2 ? 1 : -1;
    const int last = std::clamp(first + step * (kStripRows - 1), 0, p.height - 1);
    const int nearest =
        largest(small, std::min(first, last) / kDown, std::max(first, last) / kDown);
    const int count = round_up(kAcross * (nearest + 1) + kMargin - p.offset, kStep);
    return std::clamp(count, kSearchedAlways, p.disparities);
  }

  // Largest disparity, rounded down, that rows `top` to `bottom` of the small map hold often.
  int largest(const Problem& small, int top, int bottom) const {
    int counts[258] = {};
    for (int y = top; y <= std::min(bottom, small.height - 1); ++y) {
      const float* row = maps_[2].get() + static_cast<std::size_t>(y) * small.width;
      for (int x = 0; x < small.width; ++x)
        if (row[x] == row[x]) ++counts[static_cast<int>(row[x]) - small.offset];
    }
    int d = small.disparities - 1;
    for (int votes = counts[d]; d > 0 && votes < kVotes; votes += counts[--d]) {
    }
    return d + small.offset;
  }

  template <typename T>
  std::vector<T>& images(int view);

  Aggregation aggregation_;
  SpeckleFilter speckles_;
  Buffer<float> maps_[3];
  Buffer<u8> marks_[4];
  std::vector<u8> bytes_[2];
  std::vector<u16> words_[2];
};

template <>
inline std::vector<u8>& SearchRange::images<u8>(int view) {
  return bytes_[view];
}
template <>
inline std::vector<u16>& SearchRange::images<u16>(int view) {
  return words_[view];
}

}  // namespace census
