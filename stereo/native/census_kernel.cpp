// census_sgm: 5x5 census, Hamming cost, semi-global matching over 4 or 8 paths, both views.
//
// One source for every processor: census_kernel_body.hpp is compiled once for each instruction set
// and the best that the machine has is chosen at run time. All builds, and any number of threads,
// give the same bytes: the arithmetic is of integers, but for two float divisions that are exact
// to rounding everywhere.
//
// Source: Hirschmueller, TPAMI 2008 (path recursion); Spangenberg et al., IV 2014 (P2 that falls
// with the intensity step).

#include "census_kernel.hpp"
#include "disparity_checks.hpp"

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <mutex>
#include <optional>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

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

namespace py = pybind11;

namespace census {
namespace {

struct Loops {
  const char* name;
  decltype(&baseline::smooth) smooth;
  decltype(&baseline::census_transform) census_transform;
  decltype(&baseline::first_pass) first_pass;
  decltype(&baseline::second_pass) second_pass;
  decltype(&baseline::check_rows) check_rows;
  decltype(&baseline::median_rows) median_rows;
};

std::vector<Loops> supported_loops() {
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
  found.push_back(
      {"baseline", baseline::smooth, baseline::census_transform, baseline::first_pass,
                     baseline::second_pass, baseline::check_rows, baseline::median_rows});
  return found;
}

Loops choose_loops(const std::string& name) {
  const auto all = supported_loops();
  if (name == "auto") return all.front();
  for (const Loops& loops : all)
    if (name == loops.name) return loops;
  throw std::invalid_argument("this machine has no instruction set '" + name + "'");
}

// Runs the jobs side by side; an exception of any of them comes out here.
void run_together(const std::vector<std::function<void()>>& jobs, bool threads) {
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
    volume_.bytes.resize(rows * p.volume_stride());
    const std::size_t columns = p.columns(), depth = p.disparities;
    const std::size_t path = (depth + 2) * p.pixel_stride();
    for (Scratch& s : halves_) {
      for (int k = 0; k < p.vertical_paths; ++k) {
        s.previous[k].resize(path);
        s.current[k].resize(path);
      }
      s.minima.resize(6 * p.pixel_stride());
      s.penalties.resize(3 * p.pixel_stride());
      s.cost.resize(depth * kLanes);
      s.excess.resize(depth * kLanes);
      s.sums.resize(depth * p.sum_stride() + kLanes);
      s.winners.resize(5 * columns);
      s.strip_planes.resize(6 * columns * kStripRows);
      s.strip_penalty.resize((columns + 1) * kStripRows);
      s.strip_state.resize((depth + 4) * kStripRows);
      s.strip_block.resize(kStripRows * std::max(columns, kTurned * (depth + 1)));
      s.strip_first.resize(columns * (depth + 1) * kStripRows);
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
  void run(const Problem& p, const Loops& loops, const T* left, const T* right, bool flip,
           bool threads, Maps maps) {
    prepare(p);
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
        {[&] { loops.first_pass(p, left_, right_, 0, middle, 1, halves_[0], volume); },
         [&] {
           loops.first_pass(p, left_, right_, p.height - 1, middle - 1, -1, halves_[1], volume);
         }},
        threads);
    run_together({[&] {
                    loops.second_pass(p, left_, right_, middle, p.height, 1, top_rows & 1,
                                      halves_[0], volume, maps);
                  },
                  [&] {
                    loops.second_pass(p, left_, right_, middle - 1, -1, -1, bottom_rows & 1,
                                      halves_[1], volume, maps);
                  }},
                 threads);
  }

 private:
  View left_, right_;
  Volume volume_;
  Scratch halves_[2];
};

class CensusMatcher {
 public:
  CensusMatcher(const std::vector<std::array<int, 4>>& pairs, int bits, int smoothing,
                int disparities, int offset, int paths, bool own_right, int p1,
                const std::array<unsigned, 4>& across, const std::array<unsigned, 4>& upright,
                int uniqueness_percent, int subpixel, bool median, float tolerance, int speckle_px,
                int speckle_rows, float speckle_step_px, int outside_cost, int cost_weight,
                int threads, const std::string& instruction_set)
      : own_right_(own_right),
        median_(median),
        tolerance_(tolerance),
        speckle_px_(speckle_px),
        speckle_rows_(speckle_rows),
        speckle_step_px_(speckle_step_px),
        threads_(threads),
        loops_(choose_loops(instruction_set)) {
    const auto lawful = [p1](const std::array<unsigned, 4>& law, unsigned most) {
      return p1 >= 0 && p1 <= 60 && static_cast<unsigned>(p1) <= law[0] && law[0] <= law[1] &&
             law[1] <= law[2] && law[1] <= most && law[2] <= 1000 && law[3] <= (1u << 24);
    };
    const bool valid =
        disparities >= 1 && disparities <= 256 && offset >= 0 && offset <= 4096 &&
        (paths == 4 || paths == 8) && lawful(across, 127) && lawful(upright, 150) &&
        upright[1] + 2 * across[1] <= 255 && uniqueness_percent >= 0 && uniqueness_percent < 100 &&
        subpixel >= 0 && subpixel <= 2 && speckle_px >= 0 && speckle_rows >= 1 &&
        outside_cost >= 0 && outside_cost <= 24 && cost_weight >= 1 && cost_weight <= 16 &&
        bits >= 1 && bits <= 16 && smoothing >= 0 && smoothing <= 2 && threads >= 1;
    if (!valid) throw std::invalid_argument("a setting of the census matcher is out of its range");
    if (pairs.size() != 24) throw std::invalid_argument("a census has 24 pairs of pixels");
    for (std::size_t k = 0; k < 24; ++k) {
      const auto& pair = pairs[k];
      for (const int offset : pair)
        if (std::abs(offset) > 16) throw std::invalid_argument("a census reaches 16 px at most");
      problem_.pairs[k] = {pair[0], pair[1], pair[2], pair[3]};
    }
    problem_.disparities = disparities;
    problem_.offset = offset;
    problem_.vertical_paths = paths == 8 ? 3 : 1;
    problem_.uniqueness_percent = uniqueness_percent;
    problem_.p1 = static_cast<u8>(p1);
    problem_.outside_cost = static_cast<u8>(outside_cost);
    problem_.subpixel = static_cast<Subpixel>(subpixel);
    problem_.across = {across[0], across[1], across[2], across[3]};
    problem_.upright = {upright[0], upright[1], upright[2], upright[3]};
    problem_.cost_weight = static_cast<i16>(cost_weight);
    problem_.smoothing = static_cast<Smoothing>(smoothing);
    // a sum is 4 times the grey value, or 16 times; P2 is meant for grey values
    const int gained = std::min(2 * smoothing, 16 - bits);
    problem_.smoothing_shift = 2 * smoothing - gained;
    problem_.across.alpha_q16 >>= gained;
    problem_.upright.alpha_q16 >>= gained;
  }

  std::string instruction_set() const { return loops_.name; }

  template <typename T>
  py::tuple match(const py::array_t<T, py::array::c_style>& left,
                  const py::array_t<T, py::array::c_style>& right) {
    if (left.ndim() != 2 || right.ndim() != 2 || left.shape(0) != right.shape(0) ||
        left.shape(1) != right.shape(1) || left.size() == 0)
      throw std::invalid_argument("the census matcher needs two grey images of one size");
    const py::ssize_t height = left.shape(0), width = left.shape(1);
    if (height > 32768 || width > 32768)
      throw std::invalid_argument("the census matcher takes images up to 32768 x 32768");
    const std::vector<py::ssize_t> shape = {height, width};
    py::array_t<float> found[2] = {py::array_t<float>(shape), py::array_t<float>(shape)};
    py::array_t<float> checked[2] = {py::array_t<float>(shape), py::array_t<float>(shape)};
    py::array_t<u8> margins[2] = {py::array_t<u8>(shape), py::array_t<u8>(shape)};
    float* raw[2] = {found[0].mutable_data(), found[1].mutable_data()};
    float* out[2] = {checked[0].mutable_data(), checked[1].mutable_data()};
    u8* margin[2] = {margins[0].mutable_data(), margins[1].mutable_data()};
    {
      const py::gil_scoped_release release;
      const std::lock_guard<std::mutex> guard(busy_);
      compute(left.data(), right.data(), static_cast<int>(width), static_cast<int>(height), raw,
              out, margin);
    }
    return py::make_tuple(checked[0], checked[1], found[0], found[1], margins[0], margins[1]);
  }

 private:
  template <typename T>
  void compute(const T* left, const T* right, int width, int height, float* raw[2], float* out[2],
               u8* margin[2]) {
    Problem p = problem_;
    p.width = width;
    p.height = height;
    const std::size_t size = static_cast<std::size_t>(width) * height;
    for (Buffer<u8>& unique : unique_) unique.resize(size);
    u8* unique[2] = {unique_[0].get(), unique_[1].get()};
    if (!own_right_) {
      views_[0].run(p, loops_, left, right, false, threads_ > 1,
                    {raw[0], raw[1], margin[0], margin[1], unique[0], unique[1]});
    } else {
      // the right view is the left view of the mirrored and swapped pair
      const auto one = [&] {
        views_[0].run(p, loops_, left, right, false, threads_ > 1,
                      {raw[0], nullptr, margin[0], nullptr, unique[0], nullptr});
      };
      const auto two = [&] {
        views_[1].run(p, loops_, right, left, true, threads_ > 1,
                      {raw[1], nullptr, margin[1], nullptr, unique[1], nullptr});
        for (int y = 0; y < height; ++y) {
          const std::size_t row = static_cast<std::size_t>(y) * width;
          std::reverse(raw[1] + row, raw[1] + row + width);
          std::reverse(margin[1] + row, margin[1] + row + width);
          std::reverse(unique[1] + row, unique[1] + row + width);
        }
      };
      run_together({one, two}, threads_ > 3);
    }
    if (median_) {
      const auto smooth = [&](int view) {
        median_buffer_[view].resize(size);
        float* source = median_buffer_[view].get();
        std::copy(raw[view], raw[view] + size, source);
        loops_.median_rows(source, raw[view], width, height);
      };
      run_together({[&] { smooth(0); }, [&] { smooth(1); }}, threads_ > 1);
    }
    const auto check = [&](int view) {
      loops_.check_rows(raw[view], raw[1 - view], unique[view], out[view], view == 0 ? -1 : 1,
                        tolerance_, width, height);
      speckles_[view].run(out[view], width, height, speckle_px_, speckle_rows_, speckle_step_px_);
    };
    run_together({[&] { check(0); }, [&] { check(1); }}, threads_ > 1);
  }

  Problem problem_{};
  bool own_right_, median_;
  float tolerance_;
  int speckle_px_, speckle_rows_;
  float speckle_step_px_;
  SpeckleFilter speckles_[2];
  int threads_;
  Loops loops_;
  std::mutex busy_;
  Aggregation views_[2];
  Buffer<u8> unique_[2];
  Buffer<float> median_buffer_[2];
};

}  // namespace
}  // namespace census

PYBIND11_MODULE(census_kernel, module) {
  using census::CensusMatcher;
  module.doc() = "5x5 census and semi-global matching of both views (see stereo/census_sgm.py)";
  module.def("instruction_sets", [] {
    std::vector<std::string> names;
    for (const auto& loops : census::supported_loops()) names.emplace_back(loops.name);
    return py::cast(names);
  });
  using Law = std::array<unsigned, 4>;
  py::class_<CensusMatcher>(module, "CensusMatcher")
      .def(py::init<const std::vector<std::array<int, 4>>&, int, int, int, int, int, bool, int,
                    const Law&, const Law&, int, int, bool, float, int, int, float, int, int, int,
                    const std::string&>(),
           py::kw_only(), py::arg("pairs"), py::arg("bits"), py::arg("smoothing"),
           py::arg("disparities"), py::arg("offset"), py::arg("paths"), py::arg("own_right"),
           py::arg("p1"), py::arg("across"), py::arg("upright"), py::arg("uniqueness_percent"),
           py::arg("subpixel"), py::arg("median"), py::arg("tolerance"), py::arg("speckle_px"),
           py::arg("speckle_rows"), py::arg("speckle_step_px"), py::arg("outside_cost"),
           py::arg("cost_weight"), py::arg("threads"), py::arg("instruction_set"))
      .def_property_readonly("instruction_set", &CensusMatcher::instruction_set)
      .def("match", &CensusMatcher::match<std::uint8_t>, py::arg("left").noconvert(),
           py::arg("right").noconvert())
      .def("match", &CensusMatcher::match<std::uint16_t>, py::arg("left").noconvert(),
           py::arg("right").noconvert());
}
