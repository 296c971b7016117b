// census_sgm: 5x5 census, Hamming cost, semi-global matching over 4 or 8 paths, both views.
//
// One source for every processor: census_kernel_body.hpp is compiled once for each instruction set
// and the best that the machine has is chosen at run time. All builds, and any number of threads,
// give the same bytes: the arithmetic is of integers, but for two float divisions that are exact
// to rounding everywhere.
//
// Source: Hirschmueller, TPAMI 2008 (path recursion); Spangenberg et al., IV 2014 (P2 that falls
// with the intensity step).

#include "aggregation.hpp"
#include "disparity_checks.hpp"
#include "map_pool.hpp"
#include "search_range.hpp"

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <mutex>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

namespace py = pybind11;

namespace census {
namespace {

class CensusMatcher {
 public:
  CensusMatcher(const std::vector<std::array<int, 4>>& pairs, int bits, int smoothing,
                int disparities, int offset, int paths, bool own_right, int p1,
                const std::array<unsigned, 4>& across, const std::array<unsigned, 4>& upright,
                int uniqueness_percent, int subpixel, bool median, float tolerance, int speckle_px,
                int speckle_rows, float speckle_step_px, int outside_cost, int cost_weight,
                int threads, const std::string& instruction_set, bool search_strips)
      : own_right_(own_right),
        median_(median),
        search_strips_(search_strips),
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
    problem_.capacity = disparities;
    problem_.offset = offset;
    problem_.vertical_paths = paths == 8 ? 3 : 1;
    problem_.uniqueness_percent = uniqueness_percent;
    problem_.p1 = static_cast<u8>(p1);
    problem_.outside_cost = static_cast<u8>(outside_cost);
    problem_.subpixel = static_cast<Subpixel>(subpixel);
    problem_.across = {across[0], across[1], across[2], across[3]};
    problem_.upright = {upright[0], upright[1], upright[2], upright[3]};
    problem_.cost_weight = cost_weight;
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
                  const py::array_t<T, py::array::c_style>& right, std::vector<int> searched) {
    if (left.ndim() != 2 || right.ndim() != 2 || left.shape(0) != right.shape(0) ||
        left.shape(1) != right.shape(1) || left.size() == 0)
      throw std::invalid_argument("the census matcher needs two grey images of one size");
    const py::ssize_t height = left.shape(0), width = left.shape(1);
    if (height > 32768 || width > 32768)
      throw std::invalid_argument("the census matcher takes images up to 32768 x 32768");
    py::array_t<float> found[2] = {maps_->take<float>(height, width),
                                   maps_->take<float>(height, width)};
    py::array_t<float> checked[2] = {maps_->take<float>(height, width),
                                     maps_->take<float>(height, width)};
    py::array_t<u8> margins[2] = {maps_->take<u8>(height, width), maps_->take<u8>(height, width)};
    float* raw[2] = {found[0].mutable_data(), found[1].mutable_data()};
    float* out[2] = {checked[0].mutable_data(), checked[1].mutable_data()};
    u8* margin[2] = {margins[0].mutable_data(), margins[1].mutable_data()};
    {
      const py::gil_scoped_release release;
      const std::lock_guard<std::mutex> guard(busy_);
      const Problem p = problem(width, height);
      if (searched.empty()) searched = range_of(p, left.data(), right.data());
      check_searched(p, searched);
      compute(p, searched, left.data(), right.data(), raw, out, margin);
    }
    return py::make_tuple(checked[0], checked[1], found[0], found[1], margins[0], margins[1]);
  }

  // How many disparities `match` searches in each row of such a pair.
  template <typename T>
  std::vector<int> searched(const py::array_t<T, py::array::c_style>& left,
                            const py::array_t<T, py::array::c_style>& right) {
    if (left.ndim() != 2 || right.ndim() != 2 || left.shape(0) != right.shape(0) ||
        left.shape(1) != right.shape(1) || left.size() == 0)
      throw std::invalid_argument("the census matcher needs two grey images of one size");
    const std::lock_guard<std::mutex> guard(busy_);
    return range_of(problem(left.shape(1), left.shape(0)), left.data(), right.data());
  }

 private:
  Problem problem(py::ssize_t width, py::ssize_t height) const {
    Problem p = problem_;
    p.width = static_cast<int>(width);
    p.height = static_cast<int>(height);
    return p;
  }

  template <typename T>
  std::vector<int> range_of(const Problem& p, const T* left, const T* right) {
    if (search_strips_) return range_.rows(p, loops_, left, right, threads_ > 1);
    return std::vector<int>(static_cast<std::size_t>(p.height), p.disparities);
  }

  // The horizontal paths of a strip run side by side, over the same disparities.
  static void check_searched(const Problem& p, const std::vector<int>& searched) {
    bool valid = searched.size() == static_cast<std::size_t>(p.height);
    for (int y = 0; valid && y < p.height; ++y)
      valid = searched[y] >= 1 && searched[y] <= p.disparities &&
              searched[y] == searched[strip_of(y, p.height)];
    if (!valid) throw std::invalid_argument("one count for each row, the same for each strip");
  }

  template <typename T>
  void compute(const Problem& p, const std::vector<int>& searched, const T* left, const T* right,
               float* raw[2], float* out[2], u8* margin[2]) {
    const int width = p.width, height = p.height;
    const std::size_t size = static_cast<std::size_t>(width) * height;
    for (Buffer<u8>& unique : unique_) unique.resize(size);
    u8* unique[2] = {unique_[0].get(), unique_[1].get()};
    if (!own_right_) {
      views_[0].run(p, searched, loops_, left, right, false, threads_ > 1,
                    {raw[0], raw[1], margin[0], margin[1], unique[0], unique[1]});
    } else {
      // the right view is the left view of the mirrored and swapped pair
      const auto one = [&] {
        views_[0].run(p, searched, loops_, left, right, false, threads_ > 1,
                      {raw[0], nullptr, margin[0], nullptr, unique[0], nullptr});
      };
      const auto two = [&] {
        views_[1].run(p, searched, loops_, right, left, true, threads_ > 1,
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
  bool own_right_, median_, search_strips_;
  float tolerance_;
  int speckle_px_, speckle_rows_;
  float speckle_step_px_;
  SpeckleFilter speckles_[2];
  int threads_;
  Loops loops_;
  std::mutex busy_;
  Aggregation views_[2];
  SearchRange range_;
  Buffer<u8> unique_[2];
  Buffer<float> median_buffer_[2];
  std::shared_ptr<MapPool> maps_ = std::make_shared<MapPool>();
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
                    const std::string&, bool>(),
           py::kw_only(), py::arg("pairs"), py::arg("bits"), py::arg("smoothing"),
           py::arg("disparities"), py::arg("offset"), py::arg("paths"), py::arg("own_right"),
           py::arg("p1"), py::arg("across"), py::arg("upright"), py::arg("uniqueness_percent"),
           py::arg("subpixel"), py::arg("median"), py::arg("tolerance"), py::arg("speckle_px"),
           py::arg("speckle_rows"), py::arg("speckle_step_px"), py::arg("outside_cost"),
           py::arg("cost_weight"), py::arg("threads"), py::arg("instruction_set"),
           py::arg("search_strips") = false)
      .def_property_readonly("instruction_set", &CensusMatcher::instruction_set)
      .def("match", &CensusMatcher::match<std::uint8_t>, py::arg("left").noconvert(),
           py::arg("right").noconvert(), py::arg("searched") = std::vector<int>())
      .def("match", &CensusMatcher::match<std::uint16_t>, py::arg("left").noconvert(),
           py::arg("right").noconvert(), py::arg("searched") = std::vector<int>())
      .def("searched", &CensusMatcher::searched<std::uint8_t>, py::arg("left").noconvert(),
           py::arg("right").noconvert())
      .def("searched", &CensusMatcher::searched<std::uint16_t>, py::arg("left").noconvert(),
           py::arg("right").noconvert());
}
