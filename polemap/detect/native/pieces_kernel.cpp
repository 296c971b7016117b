// Straight pieces among points along the road: polemap/detect/lines/pieces.py says what and why.

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <vector>

namespace py = pybind11;
using Doubles = py::array_t<double, py::array::c_style | py::array::forcecast>;
using Longs = py::array_t<long long, py::array::c_style | py::array::forcecast>;

namespace {

struct Settings {
    double near_m, step_ahead_m, aside_m, bin_m, window_m, take_m, clear_m, gap_m, rms_max_m;
    double least_length_m, least_share, promising;
    int rows, windows, bins, slopes, tries, least_points, least_rows, shortest;
    double slope_max;

    double stride_m() const { return 0.5 * window_m; }
    double slope(int k) const { return -slope_max + 2.0 * slope_max * k / (slopes - 1); }
    double middle(int window) const { return near_m + stride_m() * (window + 1.0); }
};

struct Peak {
    float votes;
    int slope, window, bin;
};

struct Piece {
    double middle, offset, slope, start, end, rms, share;
    long long seen;
    std::vector<int> members;
};

class Search {
  public:
    Search(const double* points, const long long* source, int n, const Settings& settings)
        : set_(settings), n_(n), source_(source), x_(n), y_(n) {
        for (int i = 0; i < n; ++i) {
            x_[i] = points[2 * i];
            y_[i] = points[2 * i + 1];
        }
    }

    std::vector<Piece> run() {
        std::vector<char> free(n_, 1);
        std::vector<Piece> found;
        for (const Peak& peak : peaks()) {
            if (!promising(peak)) continue;
            std::vector<int> members;
            for (int i = 0; i < n_; ++i)
                if (free[i] && near(peak, i)) members.push_back(i);
            Piece piece;
            if (!fit(std::move(members), piece)) continue;
            for (int i = 0; i < n_; ++i) {
                const double off = y_[i] - piece.offset - piece.slope * (x_[i] - piece.middle);
                if (x_[i] >= piece.start - 0.5 && x_[i] <= piece.end + 0.5 &&
                    std::abs(off) < set_.clear_m)
                    free[i] = 0;
            }
            found.push_back(std::move(piece));
        }
        return found;
    }

  private:
    double off(const Peak& peak, int i) const {
        return y_[i] - (peak.bin + 1.0) * set_.bin_m + set_.aside_m + 2.0 -
               set_.slope(peak.slope) * (x_[i] - set_.middle(peak.window));
    }

    bool near(const Peak& peak, int i) const {
        return std::abs(x_[i] - set_.middle(peak.window)) <= 0.5 * set_.window_m &&
               std::abs(off(peak, i)) < set_.take_m;
    }

    std::vector<float> vote() const {
        const int width = set_.windows * set_.bins;
        std::vector<float> votes(static_cast<size_t>(set_.slopes) * width, 0.0f);
        for (int i = 0; i < n_; ++i) {
            const int last = std::min(static_cast<int>((x_[i] - set_.near_m) / set_.stride_m()),
                                      set_.windows - 1);
            for (const int window : {last, std::max(last - 1, 0)}) {
                const double ahead = x_[i] - set_.middle(window);
                for (int s = 0; s < set_.slopes; ++s) {
                    const double offset = y_[i] - set_.slope(s) * ahead;
                    const int bin = static_cast<int>((offset + set_.aside_m + 2.0) / set_.bin_m);
                    votes[static_cast<size_t>(s) * width + window * set_.bins +
                          std::clamp(bin, 0, set_.bins - 1)] += 1.0f;
                }
            }
        }
        for (int s = 0; s < set_.slopes; ++s) {
            float* row = votes.data() + static_cast<size_t>(s) * width;
            for (int c = 0; c + 1 < width; ++c) row[c] += row[c + 1];
        }
        return votes;
    }

    // the greatest of their neighbours, three slopes by five bins, most votes first
    std::vector<Peak> peaks() const {
        const std::vector<float> votes = vote();
        const int width = set_.windows * set_.bins;
        const auto least = static_cast<float>(0.8 * set_.least_points);
        std::vector<Peak> all;
        for (int s = 0; s < set_.slopes; ++s)
            for (int c = 0; c < width; ++c) {
                const float here = votes[static_cast<size_t>(s) * width + c];
                if (here < least) continue;
                bool greatest = true;
                for (int t = std::max(s - 1, 0); t <= std::min(s + 1, set_.slopes - 1); ++t)
                    for (int d = std::max(c - 2, 0); d <= std::min(c + 2, width - 1); ++d)
                        greatest &= votes[static_cast<size_t>(t) * width + d] <= here;
                if (greatest) all.push_back({here, s, c / set_.bins, c % set_.bins});
            }
        std::stable_sort(all.begin(), all.end(),
                         [](const Peak& a, const Peak& b) { return a.votes > b.votes; });
        if (static_cast<int>(all.size()) > set_.tries) all.resize(set_.tries);
        return all;
    }

    struct Line {
        double middle, offset, slope, spread, rms;
    };

    // least squares of `value` over x of some points
    template <class Value>
    Line line(const std::vector<int>& members, Value value) const {
        Line line{0.0, 0.0, 0.0, 0.0, 0.0};
        const double n = static_cast<double>(members.size());
        for (const int i : members) {
            line.middle += x_[i] / n;
            line.offset += value(i) / n;
        }
        double product = 0.0;
        for (const int i : members) {
            const double u = x_[i] - line.middle;
            line.spread += u * u;
            product += u * value(i);
        }
        line.slope = product / std::max(line.spread, 1e-6);
        for (const int i : members) {
            const double rest = value(i) - line.offset - line.slope * (x_[i] - line.middle);
            line.rms += rest * rest / n;
        }
        line.rms = std::sqrt(line.rms);
        return line;
    }

    bool promising(const Peak& peak) const {
        std::vector<int> members;
        for (int i = 0; i < n_; ++i)
            if (near(peak, i)) members.push_back(i);
        if (members.empty()) return false;
        const auto value = [&](int i) { return off(peak, i); };
        Line now = line(members, value);
        const double limit = std::max(2.5 * now.rms, 0.04);
        std::vector<int> kept;
        for (const int i : members)
            if (std::abs(value(i) - now.offset - now.slope * (x_[i] - now.middle)) <= limit)
                kept.push_back(i);
        if (kept.empty()) return false;
        now = line(kept, value);
        if (now.rms > set_.promising * set_.rms_max_m) return false;
        std::vector<int> shown(set_.rows + 1, 0);
        for (const int i : kept) {
            const double row = std::nearbyint((x_[i] - set_.near_m) / set_.step_ahead_m);
            shown[std::clamp(static_cast<int>(row), 0, set_.rows - 1) + 1] = 1;
        }
        for (int r = 0; r < set_.rows; ++r) shown[r + 1] += shown[r];
        // as the plain way has it, a stretch begins behind the first row
        for (int r = 1; r + set_.shortest <= set_.rows; ++r)
            if (shown[r + set_.shortest] - shown[r] >= set_.least_points) return true;
        return false;
    }

    // members between two gaps, those that reach over the longest way
    std::vector<int> longest_run(std::vector<int> members) const {
        std::stable_sort(members.begin(), members.end(),
                         [&](int a, int b) { return x_[a] < x_[b]; });
        size_t begin = 0, best = 0, best_end = 0;
        double longest = -1.0;
        for (size_t i = 1; i <= members.size(); ++i) {
            if (i < members.size() && x_[members[i]] - x_[members[i - 1]] <= set_.gap_m) continue;
            const double length = x_[members[i - 1]] - x_[members[begin]];
            if (length > longest) {
                longest = length;
                best = begin;
                best_end = i;
            }
            begin = i;
        }
        return {members.begin() + best, members.begin() + best_end};
    }

    template <class Key>
    static long long distinct(const std::vector<int>& members, Key key) {
        std::vector<long long> keys;
        for (const int i : members) keys.push_back(key(i));
        std::sort(keys.begin(), keys.end());
        return std::unique(keys.begin(), keys.end()) - keys.begin();
    }

    bool fit(std::vector<int> members, Piece& piece) const {
        const auto few = [&] { return static_cast<int>(members.size()) < set_.least_points; };
        const auto value = [&](int i) { return y_[i]; };
        if (few()) return false;
        Line now = line(members, value);
        if (now.spread <= 0.0) return false;
        const double limit = std::max(2.5 * now.rms, 0.04);
        std::vector<int> kept;
        for (const int i : members)
            if (std::abs(y_[i] - now.offset - now.slope * (x_[i] - now.middle)) <= limit)
                kept.push_back(i);
        if (kept.empty()) return false;
        members = longest_run(std::move(kept));
        if (few()) return false;
        now = line(members, value);
        if (now.spread <= 0.0) return false;
        const double start = x_[members.front()], end = x_[members.back()];
        const long long rows = distinct(members, [&](int i) {
            return static_cast<long long>(std::nearbyint(x_[i] / set_.step_ahead_m));
        });
        const double share =
            std::min(static_cast<double>(rows) / ((end - start) / set_.step_ahead_m + 1.0), 1.0);
        const long long seen = distinct(members, [&](int i) { return source_[i]; });
        if (seen < set_.least_rows || end - start < set_.least_length_m ||
            now.rms > set_.rms_max_m || share < set_.least_share || std::abs(now.slope) > 0.5)
            return false;
        piece = {now.middle, now.offset, now.slope, start, end, now.rms, share, seen,
                 std::move(members)};
        return true;
    }

    const Settings& set_;
    int n_;
    const long long* source_;
    std::vector<double> x_, y_;
};

double number(const py::dict& given, const char* name) { return given[name].cast<double>(); }

py::list straight_pieces(const Doubles& points, const Longs& source, const py::dict& given) {
    if (points.ndim() != 2 || points.shape(1) != 2 || source.ndim() != 1 ||
        source.shape(0) != points.shape(0))
        throw std::invalid_argument("points (n, 2) and their rows (n,) are needed");
    Settings set{};
    set.near_m = number(given, "near_m");
    set.step_ahead_m = number(given, "step_ahead_m");
    set.aside_m = number(given, "aside_m");
    set.bin_m = number(given, "bin_m");
    set.window_m = number(given, "window_m");
    set.take_m = number(given, "take_m");
    set.clear_m = number(given, "clear_m");
    set.gap_m = number(given, "gap_m");
    set.rms_max_m = number(given, "rms_max_m");
    set.least_length_m = number(given, "least_length_m");
    set.least_share = number(given, "least_share");
    set.promising = number(given, "promising");
    set.slope_max = number(given, "slope_max");
    const auto whole = [&](const char* name) { return given[name].cast<int>(); };
    set.rows = whole("rows");
    set.windows = whole("windows");
    set.bins = whole("bins");
    set.slopes = whole("slopes");
    set.tries = whole("tries");
    set.least_points = whole("least_points");
    set.least_rows = whole("least_rows");
    set.shortest = whole("shortest");
    const int n = static_cast<int>(points.shape(0));
    // a point before the grid would vote for a window that is none
    for (int i = 0; i < n; ++i)
        if (!(points.data()[2 * i] >= set.near_m - set.stride_m()) ||
            !std::isfinite(points.data()[2 * i]) || !std::isfinite(points.data()[2 * i + 1]))
            throw std::invalid_argument("points before the grid, or not finite");
    std::vector<Piece> pieces;
    {
        py::gil_scoped_release release;
        pieces = Search(points.data(), source.data(), n, set).run();
    }
    py::list found;
    for (const Piece& p : pieces) {
        py::array_t<long long> members(static_cast<py::ssize_t>(p.members.size()));
        std::copy(p.members.begin(), p.members.end(), members.mutable_data());
        found.append(py::make_tuple(p.middle, p.offset, p.slope, p.start, p.end, p.rms, p.share,
                                    p.seen, members));
    }
    return found;
}

}  // namespace

PYBIND11_MODULE(pieces_kernel, m) {
    m.doc() = "Straight pieces among points along the road.";
    m.def("straight_pieces", &straight_pieces, py::arg("points_m"), py::arg("source_row"),
          py::arg("settings"));
}
