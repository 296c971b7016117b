// Lines through depth edges that gather in a column and a disparity: corner_edges.py says why.

#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace corners {

struct Side {
    const std::int32_t* row;
    const float *column, *near, *far;
    const bool* occluding;
    size_t size;
};

struct Edge {
    double row, column, near, far, occluding;
    int group;
};

struct Votes {
    double low, high, column_px, share, height_min_m, fill_min, baseline_m;
    int column_cells, depth_cells, rows_min, row_step;
};

class Grouping {
  public:
    explicit Grouping(const Votes& set) : set_(set), width_(set.column_cells) {}

    void take(const Side& side, int offset) {
        const auto low = static_cast<float>(set_.low), high = static_cast<float>(set_.high);
        const auto per_px = static_cast<float>(1.0 / set_.column_px);
        for (size_t i = 0; i < side.size; ++i) {
            if (!(side.near[i] >= low && side.near[i] <= high)) continue;
            const int depth = static_cast<int>(std::log(side.near[i] / set_.low) / set_.share) + 1;
            const int across = static_cast<int>(side.column[i] * per_px) + 1;
            place_.push_back(std::min(std::max(across, 1), width_ - 2) + width_ * (depth + offset));
            edges_.push_back({static_cast<double>(side.row[i]), side.column[i], side.near[i],
                              side.far[i], side.occluding[i] ? 1.0 : 0.0, -1});
        }
    }

    // places in the flat grid about which many edges lie, the weakest first
    std::vector<int> peaks() const {
        const int rows = 2 * set_.depth_cells;
        std::vector<int> counts(static_cast<size_t>(rows) * width_, 0), beside(counts.size(), 0),
            summed(counts.size(), 0);
        for (const int place : place_) ++counts[place];
        for (int r = 0; r < rows; ++r)
            for (int c = 1; c + 1 < width_; ++c) {
                const int at = r * width_ + c;
                beside[at] = counts[at - 1] + counts[at] + counts[at + 1];
            }
        for (int r = 1; r + 1 < rows; ++r)
            for (int c = 1; c + 1 < width_; ++c) {
                const int at = r * width_ + c;
                summed[at] = beside[at - width_] + beside[at] + beside[at + width_];
            }
        std::vector<int> found;
        for (int r = 1; r + 1 < rows; ++r) {
            const double disparity =
                set_.low * std::exp((r % set_.depth_cells - 0.5) * set_.share);
            const double tall =
                set_.height_min_m * disparity / (set_.baseline_m * set_.row_step);
            const auto least = static_cast<float>(
                std::max(set_.fill_min * tall, static_cast<double>(set_.rows_min)));
            for (int c = 1; c + 1 < width_; ++c) {
                const int here = summed[r * width_ + c];
                if (static_cast<float>(here) < least) continue;
                bool greatest = true;
                for (int t = r - 1; t <= r + 1; ++t)
                    for (int d = std::max(c - 3, 0); d <= std::min(c + 3, width_ - 1); ++d)
                        greatest &= summed[t * width_ + d] <= here;
                if (greatest) found.push_back(r * width_ + c);
            }
        }
        std::stable_sort(found.begin(), found.end(),
                         [&](int a, int b) { return summed[a] < summed[b]; });
        return found;
    }

    // a cell that two peaks claim goes to the stronger one
    void label(const std::vector<int>& peaks) {
        std::vector<int> label(static_cast<size_t>(2 * set_.depth_cells) * width_, -1);
        for (size_t p = 0; p < peaks.size(); ++p)
            for (int i = -1; i <= 1; ++i)
                for (int j = -1; j <= 1; ++j)
                    label[peaks[p] + i * width_ + j] = static_cast<int>(p);
        for (size_t p = 0; p < peaks.size(); ++p) label[peaks[p]] = static_cast<int>(p);
        size_t kept = 0;
        for (size_t i = 0; i < edges_.size(); ++i) {
            edges_[i].group = label[place_[i]];
            if (edges_[i].group >= 0) edges_[kept++] = edges_[i];
        }
        edges_.resize(kept);
    }

    const std::vector<Edge>& edges() const { return edges_; }

  private:
    const Votes& set_;
    int width_;
    std::vector<int> place_;
    std::vector<Edge> edges_;
};

enum LineColumn { kRow, kColumn, kNear, kFar, kOccluding, kSlope, kSd, kTop, kBottom, kFill, kLine };

// least squares through every group's edges; what lies aside is left out once
inline std::vector<double> lines(const std::vector<Edge>& edges, int count, int row_step, double upright) {
    std::vector<double> out(static_cast<size_t>(count) * kLine, 0.0), n(count), spread(count),
        moment(count), rest(count), off(edges.size());
    std::vector<char> weight(edges.size(), 1);
    for (int sweep = 0; sweep < 2; ++sweep) {
        for (auto* sums : {&n, &spread, &moment, &rest}) std::fill(sums->begin(), sums->end(), 0.0);
        std::fill(out.begin(), out.end(), 0.0);
        for (size_t i = 0; i < edges.size(); ++i) {
            if (!weight[i]) continue;
            const Edge& e = edges[i];
            double* line = &out[static_cast<size_t>(e.group) * kLine];
            n[e.group] += 1.0;
            line[kRow] += e.row;
            line[kColumn] += e.column;
            line[kNear] += e.near;
            line[kFar] += e.far;
            line[kOccluding] += e.occluding;
        }
        for (int g = 0; g < count; ++g)
            for (int k = kRow; k <= kOccluding; ++k)
                out[static_cast<size_t>(g) * kLine + k] /= std::max(n[g], 1.0);
        for (size_t i = 0; i < edges.size(); ++i) {
            if (!weight[i]) continue;
            const double dv = edges[i].row - out[static_cast<size_t>(edges[i].group) * kLine + kRow];
            spread[edges[i].group] += dv * dv;
            moment[edges[i].group] += dv * edges[i].column;
        }
        for (int g = 0; g < count; ++g)
            out[static_cast<size_t>(g) * kLine + kSlope] = moment[g] / (spread[g] + upright);
        for (size_t i = 0; i < edges.size(); ++i) {
            const Edge& e = edges[i];
            const double* line = &out[static_cast<size_t>(e.group) * kLine];
            off[i] = e.column - line[kColumn] - line[kSlope] * (e.row - line[kRow]);
            if (weight[i]) rest[e.group] += off[i] * off[i];
        }
        for (int g = 0; g < count; ++g)
            out[static_cast<size_t>(g) * kLine + kSd] = std::sqrt(rest[g] / std::max(n[g], 1.0));
        if (sweep == 0)
            for (size_t i = 0; i < edges.size(); ++i) {
                const double sd = out[static_cast<size_t>(edges[i].group) * kLine + kSd];
                weight[i] = std::abs(off[i]) <= 2.0 * sd + 0.6;
            }
    }
    double last = 0.0;
    for (const Edge& e : edges) last = std::max(last, e.row);
    const int looked = static_cast<int>(last) / row_step + 2;
    std::vector<char> shown(static_cast<size_t>(count) * looked, 0);
    for (size_t i = 0; i < edges.size(); ++i)
        if (weight[i])
            shown[static_cast<size_t>(edges[i].group) * looked +
                  static_cast<int>(edges[i].row / row_step)] = 1;
    for (int g = 0; g < count; ++g) {
        const char* mine = &shown[static_cast<size_t>(g) * looked];
        int top = 0, bottom = looked - 1, rows = 0;
        while (top < looked && !mine[top]) ++top;
        if (top == looked) top = 0;
        while (bottom > 0 && !mine[bottom]) --bottom;
        for (int r = 0; r < looked; ++r) rows += mine[r];
        double* line = &out[static_cast<size_t>(g) * kLine];
        line[kTop] = top * row_step;
        line[kBottom] = bottom * row_step;
        line[kFill] = rows / (bottom - top + 1.0);
    }
    return out;
}

}  // namespace corners
