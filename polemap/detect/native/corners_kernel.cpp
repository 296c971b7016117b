// Upright depth edges and the walls beside them: polemap/detect/corner_edges.py and
// corner_surface.py say what and why, and hold the plain way that this one repeats.

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <cstdint>
#include <stdexcept>
#include <vector>

#include "corner_lines.hpp"
#include "corner_walls.hpp"

namespace py = pybind11;

namespace {

using corners::Grouping;
using corners::kLine;
using corners::Rules;
using corners::Side;
using corners::View;
using corners::Votes;
using corners::Wall;
using corners::WallOut;

template <class T>
using Array = py::array_t<T, py::array::c_style | py::array::forcecast>;
using Doubles = Array<double>;
using Floats = Array<float>;

void need(bool good, const char* what) {
    if (!good) throw std::invalid_argument(what);
}

double number(const py::dict& given, const char* name) { return given[name].cast<double>(); }
int whole(const py::dict& given, const char* name) { return given[name].cast<int>(); }

struct HeldSide {
    Side side;
    Array<std::int32_t> row;
    Floats column, near, far;
    Array<bool> occluding;
};

HeldSide side_of(const py::tuple& columns) {
    const auto row = columns[0].cast<Array<std::int32_t>>();
    const auto column = columns[1].cast<Floats>(), near = columns[2].cast<Floats>(),
               far = columns[3].cast<Floats>();
    const auto occluding = columns[4].cast<Array<bool>>();
    const auto n = row.size();
    need(column.size() == n && near.size() == n && far.size() == n && occluding.size() == n,
         "columns of depth edges of unequal length");
    return {{row.data(), column.data(), near.data(), far.data(), occluding.data(),
             static_cast<size_t>(n)}, row, column, near, far, occluding};
}

// `left`, `right`: row, column, near, far and occluding of the flanks, `(n,)` each.
py::tuple upright_lines(const py::tuple& left, const py::tuple& right, const py::dict& given) {
    Votes set{};
    set.low = number(given, "low");
    set.high = number(given, "high");
    set.column_px = number(given, "column_px");
    set.share = number(given, "share");
    set.height_min_m = number(given, "height_min_m");
    set.fill_min = number(given, "fill_min");
    set.baseline_m = number(given, "baseline_m");
    set.column_cells = whole(given, "column_cells");
    set.depth_cells = whole(given, "depth_cells");
    set.rows_min = whole(given, "rows_min");
    set.row_step = whole(given, "row_step_px");
    const double upright = number(given, "upright_px2");
    const HeldSide one = side_of(left), two = side_of(right);
    std::vector<double> found;
    std::vector<int> peaks;
    {
        py::gil_scoped_release release;
        Grouping grouping(set);
        grouping.take(one.side, 0);
        // the right flanks' cells lie below those of the left flanks
        grouping.take(two.side, set.depth_cells);
        peaks = grouping.peaks();
        grouping.label(peaks);
        found = corners::lines(grouping.edges(), static_cast<int>(peaks.size()), set.row_step, upright);
    }
    const auto count = static_cast<py::ssize_t>(peaks.size());
    Array<double> table({static_cast<py::ssize_t>(kLine), count});
    Array<double> free(count);
    for (py::ssize_t g = 0; g < count; ++g) {
        for (int k = 0; k < kLine; ++k) table.mutable_at(k, g) = found[g * kLine + k];
        free.mutable_at(g) = peaks[g] >= set.depth_cells * set.column_cells ? 1.0 : -1.0;
    }
    return py::make_tuple(free, table);
}

std::vector<double> list(const py::dict& given, const char* name) {
    std::vector<double> values;
    for (const auto& value : given[name].cast<py::sequence>()) values.push_back(value.cast<double>());
    return values;
}

// `edges` (n, 9): column, row, slope, top, bottom, disparity, free, pixels a metre, foot.
py::tuple walls(const Doubles& edges, const Floats& left, const Floats& right,
                const py::dict& given) {
    need(edges.ndim() == 2 && edges.shape(1) == 9, "edges (n, 9) are needed");
    need(left.ndim() == 2 && right.ndim() == 2 && left.shape(0) == right.shape(0) &&
             left.shape(1) == right.shape(1),
         "two maps of one size are needed");
    Rules set{};
    set.rows = whole(given, "rows");
    set.row_step = whole(given, "row_step_px");
    set.height_px = whole(given, "height_px");
    set.clear_px = number(given, "clear_px");
    set.highest_m = number(given, "highest_m");
    set.focal_baseline = number(given, "focal_baseline");
    set.free_m = number(given, "free_m");
    set.slope_prior = number(given, "slope_prior");
    set.shared = number(given, "shared");
    set.inward = list(given, "inward_m");
    set.outward = list(given, "outward_m");
    set.above = list(given, "above_m");
    const auto in = static_cast<py::ssize_t>(set.inward.size());
    const auto out = static_cast<py::ssize_t>(set.outward.size());
    need(set.rows <= corners::kRowsMax && in >= 5 && in <= corners::kInMax &&
             out <= corners::kOutMax, "too many samples");
    const py::ssize_t n = edges.shape(0), h = set.rows;
    Array<double> table({py::ssize_t{6}, n});
    Array<bool> on({n, h, in}), nearer({n, h, in}), seen({n, h, in}), inside({n, h}),
        free({n, h, out}), beside({n, h, out}), blank({n, h, out});
    const WallOut to{table.mutable_data(), on.mutable_data(), nearer.mutable_data(),
                     seen.mutable_data(), inside.mutable_data(), free.mutable_data(),
                     beside.mutable_data(), blank.mutable_data(), n};
    const View view{left.data(), right.data(), static_cast<int>(left.shape(0)),
                    static_cast<int>(left.shape(1))};
    {
        py::gil_scoped_release release;
        for (py::ssize_t i = 0; i < n; ++i) {
            Wall wall(set, view, edges.data() + 9 * i);
            wall.sample();
            wall.fit();
            wall.write(to, i);
        }
    }
    return py::make_tuple(table, on, nearer, seen, inside, free, beside, blank);
}

}  // namespace

PYBIND11_MODULE(corners_kernel, m) {
    m.doc() = "Upright depth edges and the walls beside them.";
    m.def("upright_lines", &upright_lines, py::arg("left"), py::arg("right"), py::arg("settings"));
    m.def("walls", &walls, py::arg("edges"), py::arg("left"), py::arg("right"),
          py::arg("settings"));
}
