// One source, several builds of the hot loops, and the aggregation of one view by two threads.
#pragma once

#include <algorithm>
#include <exception>
#include <functional>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include "census_kernel.hpp"

#define KERNEL_NAMESPACE baseline
#define KERNEL_TARGET
#define KERNEL_BYTES 16
#include "census_kernel_body.hpp"
#undef KERNEL_NAMESPACE
#undef KERNEL_TARGET
#undef KERNEL_BYTES

#if defined(__x86_64__) && defined(__GNUC__)
#define CENSUS_HAS_X86_VARIANTS 1
#define KERNEL_NAMESPACE avx2
#define KERNEL_TARGET __attribute__((target("avx2,bmi,bmi2,lzcnt,popcnt")))
#define KERNEL_BYTES 32
#include "census_kernel_body.hpp"
#undef KERNEL_NAMESPACE
#undef KERNEL_TARGET
#undef KERNEL_BYTES

#if defined(__clang__)
#define CENSUS_WIDE ""
#else
#define CENSUS_WIDE ",prefer-vector-width=512"
#endif
#define KERNEL_NAMESPACE avx512
#define KERNEL_TARGET                                                                 \
  __attribute__((target("avx2,bmi,bmi2,lzcnt,popcnt,avx512f,avx512bw,avx512vl,avx512dq," \
                        "avx512bitalg,avx512vpopcntdq,avx512vbmi" CENSUS_WIDE)))
#define KERNEL_HAS_BYTE_POPCOUNT 1
#define KERNEL_BYTES 64
#include "census_kernel_body.hpp"
#undef KERNEL_NAMESPACE
#undef KERNEL_TARGET
#undef KERNEL_BYTES
#undef KERNEL_HAS_BYTE_POPCOUNT
#endif

namespace census {

struct Loops {
  const char* name;
  decltype(&baseline::smooth) smooth;
  decltype(&baseline::census_transform) census_transform;
  decltype(&baseline::first_pass) first_pass;
  decltype(&baseline::second_pass) second_pass;
  decltype(&baseline::check_rows) check_rows;
  decltype(&baseline::median_rows) median_rows;
};

inline std::vector<Loops> supported_loops() {
  std::vector<Loops> found;
#if defined(CENSUS_HAS_X86_VARIANTS)
  __builtin_cpu_init();
  if (__builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512vl") &&
      __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512bitalg") &&
      __builtin_cpu_supports("avx512vpopcntdq") && __builtin_cpu_supports("avx512vbmi"))
    found.push_back({"avx512", avx512::smooth, avx512::census_transform, avx512::first_pass,
                     avx512::second_pass, avx512::check_rows, avx512::median_rows});
  if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("bmi2"))
    found.push_back({"avx2", avx2::smooth, avx2::census_transform, avx2::first_pass,
                     avx2::second_pass, avx2::check_rows, avx2::median_rows});
#endif
  found.push_back({"baseline", baseline::smooth, baseline::census_transform, baseline::first_pass,
                   baseline::second_pass, baseline::check_rows, baseline::median_rows});
  return found;
}

inline Loops choose_loops(const std::string& name) {
  const auto all = supported_loops();
  if (name == "auto") return all.front();
  for (const Loops& loops : all)
    if (name == loops.name) return loops;
  throw std::invalid_argument("this machine has no instruction set '" + name + "'");
}

// Runs the jobs side by side; an exception of any of them comes out here.
inline void run_together(const std::vector<std::function<void()>>& jobs, bool threads) {
  if (!threads) {
    for (const auto& job : jobs) job();
    return;
  }
  std::vector<std::exception_ptr> errors(jobs.size());
  std::vector<std::thread> others;
  const auto guarded = [&](std::size_t i) {
    try {
      jobs[i]();
    } catch (...) {
      errors[i] = std::current_exception();
    }
  };
  for (std::size_t i = 1; i < jobs.size(); ++i) others.emplace_back(guarded, i);
  guarded(0);
  for (std::thread& other : others) other.join();
  for (const std::exception_ptr& error : errors)
    if (error) std::rethrow_exception(error);
}

// One aggregation: from two images to the winners of one view or of both.
class Aggregation {
 public:
  void prepare(const Problem& p) {
    const std::size_t rows = p.height;
    for (View* view : {&left_, &right_}) {
      view->pixels.resize(rows * p.pixel_stride());
      view->scratch.resize(2 * p.pixel_stride());
      view->planes.resize(3 * rows * p.plane_stride() + kLanes);
    }
    const std::size_t columns = p.columns(), depth = p.capacity;
    const std::size_t chunks = (columns + kTurned - 1) / kTurned;
    for (Scratch& s : halves_) {
      s.paths.resize(p.vertical_paths * p.state_size());
      s.minima.resize(6 * p.pixel_stride());
      s.penalties.resize(3 * p.pixel_stride());
      s.cost.resize(depth * kLanes);
      s.excess.resize(depth * kLanes);
      s.scores.resize(depth * p.score_stride() + kLanes);
      s.winners.resize(5 * columns);
      s.strip_planes.resize(6 * columns * kStripRows);
      s.strip_penalty.resize((columns + 1) * kStripRows);
      s.strip_states.resize((chunks + 1) * p.strip_state_size());
      s.strip_block.resize(std::max(columns * kStripRows, 2 * kTurned * p.strip_column()));
      s.strip_sum.resize(kStripRows * p.volume_stride());
    }
  }

  // Copies an image into its padded rows; `flip` mirrors it.
  template <typename T>
  static void load(const Problem& p, View& view, const T* image, bool flip) {
    for (int y = 0; y < p.height; ++y) {
      const T* source = image + static_cast<std::size_t>(y) * p.width;
      u16* row = view.pixels.get() + static_cast<std::size_t>(y) * p.pixel_stride();
      u16* target = row + kLanes;
      if (flip)
        for (int x = 0; x < p.width; ++x) target[x] = source[p.width - 1 - x];
      else
        for (int x = 0; x < p.width; ++x) target[x] = source[x];
      std::fill(row, target, target[0]);
      std::fill(target + p.width, row + p.pixel_stride(), target[p.width - 1]);
    }
  }

  template <typename T>
  void run(const Problem& p, const std::vector<int>& searched, const Loops& loops, const T* left,
           const T* right, bool flip, bool threads, Maps maps) {
    prepare(p);
    rows_.clear();
    std::size_t place = 0;
    for (const int count : searched) {
      rows_.push_back({count, place});
      place += p.searching(count).volume_stride();
    }
    volume_.bytes.resize(place);
    const Searched* rows = rows_.data();
    const int middle = p.height / 2;
    const auto prepare_view = [&](View& view, const T* image) {
      load(p, view, image, flip);
      loops.smooth(p, view);
      loops.census_transform(p, view);
    };
    run_together({[&] { prepare_view(left_, left); }, [&] { prepare_view(right_, right); }},
                 threads);
    u8* volume = volume_.bytes.get();
    const int top_rows = middle, bottom_rows = p.height - middle;
    run_together(
        {[&] { loops.first_pass(p, rows, left_, right_, 0, middle, 1, halves_[0], volume); },
         [&] {
           loops.first_pass(p, rows, left_, right_, p.height - 1, middle - 1, -1, halves_[1], volume);
         }},
        threads);
    run_together({[&] {
                    loops.second_pass(p, rows, left_, right_, middle, p.height, 1, top_rows & 1,
                                      halves_[0], volume, maps);
                  },
                  [&] {
                    loops.second_pass(p, rows, left_, right_, middle - 1, -1, -1, bottom_rows & 1,
                                      halves_[1], volume, maps);
                  }},
                 threads);
  }

 private:
  View left_, right_;
  Volume volume_;
  std::vector<Searched> rows_;
  Scratch halves_[2];
};

}  // namespace census
