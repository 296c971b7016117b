// Rows of the road grid, cell by cell: polemap/detect/lines/road_frame.py, kerbs.py and markings.py
// say what and why, and hold the plain way that this one repeats, in single precision as there.

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <stdexcept>
#include <string>
#include <vector>

namespace py = pybind11;

namespace {

template <class T>
using Array = py::array_t<T, py::array::c_style | py::array::forcecast>;
using Doubles = Array<double>;
using Floats = Array<float>;
using Bytes = Array<std::uint8_t>;

float single(const py::dict& given, const char* name) {
    return static_cast<float>(given[name].cast<double>());
}
int whole(const py::dict& given, const char* name) { return given[name].cast<int>(); }

template <class T>
void need_grid(const Array<T>& grid, py::ssize_t rows, py::ssize_t columns, const char* name) {
    if (grid.ndim() != 2 || grid.shape(0) != rows || grid.shape(1) != columns)
        throw std::invalid_argument(std::string(name) + ": a grid of another size");
}

py::array_t<double> column(const std::vector<std::vector<double>>& rows, int k) {
    py::array_t<double> values(static_cast<py::ssize_t>(rows.size()));
    for (size_t i = 0; i < rows.size(); ++i) values.mutable_data()[i] = rows[i][k];
    return values;
}

py::list table(const std::vector<std::vector<double>>& rows, int columns) {
    py::list all;
    for (int k = 0; k < columns; ++k) all.append(column(rows, k));
    return all;
}

// Heights over the plane, which cells are matched, and which the image shows.
py::tuple heights(const Floats& disparity, const Doubles& pixel_from_cell, const Doubles& plane,
                  double height_m, int row_step, int width_px, int height_px) {
    if (disparity.ndim() != 2 || pixel_from_cell.size() != 9 || plane.size() != 3)
        throw std::invalid_argument("a grid, a homography and a plane are needed");
    const py::ssize_t rows = disparity.shape(0), columns = disparity.shape(1);
    Array<bool> inside({rows, columns});
    Floats height({rows, columns}), matched({rows, columns});
    Doubles expected_middle(rows);
    Array<std::int64_t> image_row(rows);
    const double* h = pixel_from_cell.data();
    const auto step = static_cast<float>(row_step);
    const auto per_column = static_cast<float>(plane.data()[1]);
    const auto per_row = static_cast<float>(plane.data()[2] * row_step);
    const auto offset = static_cast<float>(plane.data()[0]);
    const auto camera = static_cast<float>(height_m);
    const float* seen = disparity.data();
    bool* in = inside.mutable_data();
    float *up = height.mutable_data(), *there = matched.mutable_data();
    double* middle_px = expected_middle.mutable_data();
    std::int64_t* middle_row = image_row.mutable_data();
    {
        py::gil_scoped_release release;
        for (py::ssize_t r = 0; r < rows; ++r) {
            // the axis to the left is level in the image: a row of the grid has one depth
            const double depth = h[7] * static_cast<double>(r) + h[8];
            const double u_row = (h[1] * static_cast<double>(r) + h[2]) / depth;
            const double v_row = (h[4] * static_cast<double>(r) + h[5]) / depth;
            const double u_step = h[0] / depth, v_step = h[3] / depth;
            const auto at = [&](py::ssize_t c) {
                return static_cast<float>(v_step * static_cast<double>(c) + v_row);
            };
            const auto u_at = [&](py::ssize_t c) {
                return static_cast<float>(u_step * static_cast<double>(c) + u_row);
            };
            // the disparity belongs to the middle of the pixel that was taken, not to the cell's
            const auto plane_px = [&](py::ssize_t c) {
                const float along = per_column * u_at(c) + offset;
                return std::nearbyint(at(c) / step) * per_row + along;
            };
            const float middle = at(columns / 2);
            const bool row_inside =
                middle > 1.0f && middle < static_cast<float>(height_px - 2);
            middle_px[r] = plane_px(columns / 2);
            middle_row[r] = static_cast<std::int64_t>(std::nearbyint(middle));
            for (py::ssize_t c = 0; c < columns; ++c) {
                const py::ssize_t cell = r * columns + c;
                const float u = u_at(c);
                in[cell] = row_inside && u > 1.0f && u < static_cast<float>(width_px - 2);
                there[cell] = seen[cell] > 0.0f ? 1.0f : 0.0f;
                up[cell] = camera * (1.0f - plane_px(c) / std::max(seen[cell], 0.1f)) * there[cell];
            }
        }
    }
    return py::make_tuple(inside, height, matched, expected_middle, image_row);
}

// ---- kerbs ----

struct Grid {
    const float *height, *matched;
    int rows, columns;
    float least_matched;

    static int mirrored(int i, int n) { return i < 0 ? -i : i >= n ? 2 * n - 2 - i : i; }

    // mean of the matched heights in a box of three about a cell; NaN where few are matched
    float mean(int row, int column) const {
        double up = 0.0, there = 0.0;
        for (int i = -1; i <= 1; ++i)
            for (int j = -1; j <= 1; ++j) {
                const int cell =
                    mirrored(row + i, rows) * columns + mirrored(column + j, columns);
                up += height[cell];
                there += matched[cell];
            }
        const auto share = static_cast<float>(there * (1.0 / 9.0));
        if (share < least_matched) return NAN;
        return static_cast<float>(up * (1.0 / 9.0)) / share;
    }
};

struct KerbRules {
    int reach;
    float step_max, flat_m, flat_share, low_m, camera;
    double step_aside, aside, blunt_m;

    double left_m(double column) const { return -aside + (column + 0.5) * step_aside; }
};

// Where the profile passes half the step; false where the rise is a slope.
bool located(const Grid& grid, const KerbRules& set, int row, int column, int side, float step,
             float level, double& place) {
    const int r = set.reach, n = 2 * r + 1;
    std::vector<float> over(n);
    for (int k = 0; k < n; ++k) over[k] = grid.mean(row, column + side * (k - r)) - level;
    int first = -1;
    double nearest = INFINITY;
    for (int k = 0; k + 1 < n; ++k) {
        const double away = std::abs(k - r + 0.5);
        if (over[k] < 0.0f && over[k + 1] >= 0.0f && away < nearest) {
            nearest = away;
            first = k;
        }
    }
    if (first < 0) return false;
    const float quarter = 0.25f * step;
    int low = -r, high = 3 * r;
    for (int k = 0; k <= first; ++k)
        if (over[k] <= -quarter) low = std::max(low, k);
    for (int k = n - 1; k > first; --k)
        if (over[k] >= quarter) high = std::min(high, k);
    const double face = static_cast<double>(0.5f * step / set.camera) * std::abs(set.left_m(column));
    if (!((high - low) * set.step_aside - face < set.blunt_m)) return false;
    const float part = -over[first] / (over[first + 1] - over[first]);
    place = set.left_m(column + side * (first - r + static_cast<double>(part)));
    return true;
}

// Row, side, step, level and place of every rise.
py::list kerbs(const Floats& ground, const Floats& height, const Floats& matched,
               const Doubles& least, const py::dict& given) {
    const py::ssize_t rows = ground.shape(0), columns = ground.shape(1);
    need_grid(height, rows, columns, "heights");
    need_grid(matched, rows, columns, "matched");
    if (least.ndim() != 1 || least.shape(0) != rows)
        throw std::invalid_argument("a least step for every row is needed");
    const KerbRules set{whole(given, "reach"), single(given, "step_max"), single(given, "flat_m"),
                        single(given, "flat_share"), single(given, "low_m"),
                        single(given, "height_m"), given["step_aside"].cast<double>(),
                        given["aside"].cast<double>(), given["blunt_m"].cast<double>()};
    const Grid grid{height.data(), matched.data(), static_cast<int>(rows),
                    static_cast<int>(columns), single(given, "least_matched")};
    const int n = grid.columns, r = set.reach, begin = 2 * r, end = n - 2 * r;
    std::vector<std::vector<double>> found;
    {
        py::gil_scoped_release release;
        std::vector<float> step(n);
        for (int row = 0; row < grid.rows; ++row) {
            const float* mean = ground.data() + static_cast<size_t>(row) * n;
            for (int c = begin; c < end; ++c) {
                const float rise = mean[c + r] - mean[c - r];
                step[c] = set.left_m(c) < 0.0 ? -rise : rise;
            }
            for (int c = begin; c < end; ++c) {
                // NaN where a side is not known: every comparison fails
                if (!(step[c] >= least.data()[row] && step[c] <= set.step_max)) continue;
                if (c > begin && !(step[c] >= step[c - 1])) continue;
                if (c + 1 < end && !(step[c] > step[c + 1])) continue;
                const int side = set.left_m(c) < 0.0 ? -1 : 1, out = side * r;
                const float low = mean[c - out], high = mean[c + out];
                const float allowed = set.flat_m + set.flat_share * step[c];
                if (!(std::abs(mean[c + 2 * out] - high) < allowed) ||
                    !(std::abs(low - mean[c - 2 * out]) < allowed) || !(std::abs(low) < set.low_m))
                    continue;
                const float level = 0.5f * (low + high);
                double place = 0.0;
                if (located(grid, set, row, c, side, step[c], level, place))
                    found.push_back({static_cast<double>(row), static_cast<double>(side), step[c],
                                     level, place});
            }
        }
    }
    return table(found, 5);
}

// ---- stripes ----

struct StripeRules {
    int reach, step_at;
    float least_levels, least_share, sides_share, scatter_share, rise_max, ground_m;
    double width_min, width_max, step_aside, aside;
};

struct Flank {
    double half;
    float light, scatter;
};

// `outward` steps from the stripe's middle over one flank, `reach` cells
Flank flank(const std::uint8_t* middle, int direction, float top, int reach) {
    const auto at = [&](int k) { return static_cast<float>(middle[direction * k]); };
    float least = at(1);
    for (int k = 2; k < 9; ++k) least = std::min(least, at(k));
    const float half = 0.5f * (top + least);
    int first = 0;
    while (first <= reach && !(at(first) < half)) ++first;
    if (first > reach) first = 0;
    Flank found{INFINITY, 0.0f, 0.0f};
    if (first > 0) {
        const float inner = at(first - 1), outer = at(first);
        found.half = first - 1 + static_cast<double>((inner - half) / std::max(inner - outer, 1e-6f));
    }
    float beside[7], mean = 0.0f, squares = 0.0f;
    for (int k = 0; k < 7; ++k) {
        beside[k] = at(std::min(first + 1 + k, reach));
        mean += beside[k];
    }
    mean /= 7.0f;
    for (const float value : beside) squares += (value - mean) * (value - mean);
    std::sort(beside, beside + 7);
    // a double line has its twin in one side: the median does not see it; nor is a tar seam along
    // the paint, two of its seven columns, a scatter
    found.light = beside[3];
    found.scatter = std::min(std::sqrt(squares / 7.0f),
                             std::min(beside[3] - beside[0], beside[6] - beside[2]));
    return found;
}

// Row, level, width, place and contrast of every stripe that a row crosses.
py::list stripes(const Bytes& answer, const Bytes& light, const Array<bool>& inside,
                 const Floats& ground, const py::dict& given) {
    const py::ssize_t rows = answer.shape(0), columns = answer.shape(1);
    need_grid(light, rows, columns, "light");
    need_grid(inside, rows, columns, "inside");
    need_grid(ground, rows, columns, "ground");
    const StripeRules set{whole(given, "reach"), whole(given, "step_at"),
                          single(given, "least_levels"), single(given, "least_share"),
                          single(given, "sides_share"), single(given, "scatter_share"),
                          single(given, "rise_max"), single(given, "ground_m"),
                          given["width_min"].cast<double>(), given["width_max"].cast<double>(),
                          given["step_aside"].cast<double>(), given["aside"].cast<double>()};
    const int n = static_cast<int>(columns);
    if (set.reach < 9 || set.step_at > set.reach || n <= 2 * set.reach)
        throw std::invalid_argument("a profile that the grid does not hold");
    std::vector<std::vector<double>> found;
    {
        py::gil_scoped_release release;
        for (py::ssize_t row = 0; row < rows; ++row) {
            const py::ssize_t first = row * columns;
            const std::uint8_t* here = answer.data() + first;
            const float* level = ground.data() + first;
            for (int c = set.reach; c < n - set.reach; ++c) {
                if (here[c] < set.least_levels || here[c] < here[c - 1] || here[c] <= here[c + 1] ||
                    !inside.data()[first + c])
                    continue;
                // NaN, where the ground is not known, is no road; a bright kerbstone has a step
                if (!(std::abs(level[c]) < set.ground_m) ||
                    std::abs(level[c + set.step_at] - level[c - set.step_at]) >= set.rise_max)
                    continue;
                const std::uint8_t* middle = light.data() + first + c;
                const auto top = static_cast<float>(std::max({middle[-1], middle[0], middle[1]}));
                const Flank right = flank(middle, -1, top, set.reach);
                const Flank left = flank(middle, 1, top, set.reach);
                const double width = (right.half + left.half) * set.step_aside;
                const float brighter = std::max(right.light, left.light);
                const float contrast = top - brighter;
                if (!(width >= set.width_min && width <= set.width_max) ||
                    !(std::abs(right.light - left.light) <= set.sides_share * contrast) ||
                    !(std::max(right.scatter, left.scatter) <= set.scatter_share * contrast) ||
                    !(contrast >= std::max(set.least_share * brighter, set.least_levels)))
                    continue;
                const double at = c + 0.5 * (left.half - right.half);
                found.push_back({static_cast<double>(row), level[c], width,
                                 -set.aside + (at + 0.5) * set.step_aside,
                                 contrast / std::max(brighter, 1.0f)});
            }
        }
    }
    return table(found, 5);
}

}  // namespace

PYBIND11_MODULE(road_kernel, m) {
    m.doc() = "Heights, kerbs and stripes on the grid of the road.";
    m.def("heights", &heights, py::arg("disparity"), py::arg("pixel_from_cell"), py::arg("plane"),
          py::arg("height_m"), py::arg("row_step_px"), py::arg("width_px"), py::arg("height_px"));
    m.def("kerbs", &kerbs, py::arg("ground_m"), py::arg("height_m"), py::arg("matched"),
          py::arg("least_m"), py::arg("settings"));
    m.def("stripes", &stripes, py::arg("answer"), py::arg("light"), py::arg("inside"),
          py::arg("ground_m"), py::arg("settings"));
}
