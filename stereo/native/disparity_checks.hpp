// What is done to finished disparity maps: small components go.
#pragma once

#include <algorithm>
#include <cstring>
#include <utility>
#include <vector>

#include "census_kernel.hpp"

namespace census {

// Removes connected components (four neighbours, disparity steps of at most `step_px`) that have
// fewer than `least_px` pixels, unless they reach over `tall_rows` rows: a thin pole is small but
// tall, a wrong match is small and low.
class SpeckleFilter {
 public:
  void run(float* map, int width, int height, int least_px, int tall_rows, float step_px) {
    if (least_px <= 1) return;
    runs_.clear();
    first_of_row_.clear();
    breaks_.resize(round_up(width + 1, 8));
    above_.resize(width);
    for (int y = 0; y < height; ++y) {
      first_of_row_.push_back(runs_.size());
      const float* row = map + static_cast<std::size_t>(y) * width;
      find_runs(row, width, y, step_px);
      if (y > 0) join_rows(row, row - width, width, step_px);
    }
    first_of_row_.push_back(runs_.size());
    for (int y = 0; y < height; ++y) {
      float* row = map + static_cast<std::size_t>(y) * width;
      for (std::size_t i = first_of_row_[y]; i < first_of_row_[y + 1]; ++i) {
        const Run& root = runs_[find(i)];
        if (root.size >= least_px || root.last_row - root.first_row + 1 >= tall_rows) continue;
        std::fill(row + runs_[i].begin, row + runs_[i].end, __builtin_nanf(""));
      }
    }
  }

 private:
  // Connected pixels of a row, and what is known of their component if they are its root.
  struct Run {
    std::size_t parent;
    int begin, end, size, first_row, last_row;
  };

  std::size_t find(std::size_t run) {
    while (runs_[run].parent != run) {
      runs_[run].parent = runs_[runs_[run].parent].parent;
      run = runs_[run].parent;
    }
    return run;
  }

  void join(std::size_t one, std::size_t other) {
    one = find(one);
    other = find(other);
    if (one == other) return;
    if (other < one) std::swap(one, other);  // the older one has the smaller first row
    Run& root = runs_[one];
    root.size += runs_[other].size;
    root.last_row = std::max(root.last_row, runs_[other].last_row);
    runs_[other].parent = one;
  }

  void find_runs(const float* row, int width, int y, float step_px) {
    u8* breaks = breaks_.get();  // 1 where a run begins, or what is not known
    breaks[0] = row[0] == row[0];
    for (int x = 1; x < width; ++x) {
      const bool joined = __builtin_fabsf(row[x] - row[x - 1]) <= step_px;
      breaks[x] = (!joined) & ((row[x] == row[x]) | (row[x - 1] == row[x - 1]));
    }
    std::memset(breaks + width, 0, breaks_.count() - width);
    breaks[width] = 1;
    int begin = -1;
    for (int x = 0; x <= width; x += 8) {
      std::uint64_t eight;
      std::memcpy(&eight, breaks + x, sizeof(eight));
      if (eight == 0) continue;
      for (int at = x; at < x + 8 && at <= width; ++at) {
        if (breaks[at] == 0) continue;
        if (begin >= 0) runs_.push_back({runs_.size(), begin, at, at - begin, y, y});
        begin = at < width && row[at] == row[at] ? at : -1;
      }
    }
  }

  // Joins the runs of the last row to those of the row above that they touch.
  void join_rows(const float* row, const float* up, int width, float step_px) {
    u8* above = above_.get();
    for (int x = 0; x < width; ++x) above[x] = __builtin_fabsf(row[x] - up[x]) <= step_px;
    std::size_t upper = first_of_row_[first_of_row_.size() - 2];
    const std::size_t first = first_of_row_.back();
    for (std::size_t lower = first; lower < runs_.size(); ++lower) {
      while (upper < first && runs_[upper].end <= runs_[lower].begin) ++upper;
      for (std::size_t other = upper; other < first && runs_[other].begin < runs_[lower].end;
           ++other) {
        const int begin = std::max(runs_[lower].begin, runs_[other].begin);
        const int end = std::min(runs_[lower].end, runs_[other].end);
        if (std::memchr(above + begin, 1, static_cast<std::size_t>(end - begin)) != nullptr)
          join(lower, other);
      }
    }
  }

  std::vector<Run> runs_;
  std::vector<std::size_t> first_of_row_;
  Buffer<u8> breaks_, above_;
};

}  // namespace census
