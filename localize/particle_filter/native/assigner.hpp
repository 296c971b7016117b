// Optimal assignment of one sparse problem: components, then shortest augmenting paths.
#pragma once

#include <algorithm>
#include <cstddef>
#include <limits>
#include <utility>
#include <vector>

namespace assignment {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr int kFree = -1;

struct Edge {
  int row;
  int column;
  double cost;
};

// Solves one sparse assignment problem at a time; its buffers are reused from problem to problem.
class Assigner {
 public:
  // Minimises the cost of the chosen edges plus `unassigned[row]` of every row left alone.
  // Returns false if a row can neither be matched nor left alone. `match` receives the column of
  // every row, or kFree; `matched` counts the rows that have one.
  bool solve(const std::vector<Edge>& edges, const double* unassigned, int rows, int columns,
             double* total, int* match, int* matched) {
    row_degree_.assign(rows, 0);
    column_degree_.assign(columns, 0);
    std::fill(match, match + rows, kFree);
    bool simple = true;
    for (const Edge& edge : edges) {
      simple &= ++row_degree_[edge.row] == 1;
      simple &= ++column_degree_[edge.column] == 1;
    }
    if (simple) {
      for (const Edge& edge : edges) match[edge.row] = edge.column;
      return sum(edges, unassigned, rows, total, match, matched);
    }
    split(edges, rows, columns);
    for (int component = 0; component < components_; ++component) {
      const int r = static_cast<int>(rows_of_[component].size());
      if (r == 1) {
        solve_row(edges, unassigned, component, match);
      } else if (!solve_component(edges, unassigned, component, match)) {
        return false;
      }
    }
    return sum(edges, unassigned, rows, total, match, matched);
  }

 private:
  bool sum(const std::vector<Edge>& edges, const double* unassigned, int rows, double* total,
           const int* match, int* matched) {
    double cost = 0.0;
    int count = 0;
    for (const Edge& edge : edges)
      if (match[edge.row] == edge.column) cost += edge.cost;
    for (int row = 0; row < rows; ++row) {
      if (match[row] == kFree) {
        cost += unassigned[row];
      } else {
        ++count;
      }
    }
    *total = cost;
    *matched = count;
    return cost < kInfinity;
  }

  int find(int node) {
    while (parent_[node] != node) node = parent_[node] = parent_[parent_[node]];
    return node;
  }

  // Connected components of the bipartite graph: rows are nodes 0..rows-1, columns follow.
  void split(const std::vector<Edge>& edges, int rows, int columns) {
    parent_.resize(rows + columns);
    for (int node = 0; node < rows + columns; ++node) parent_[node] = node;
    for (const Edge& edge : edges) {
      const int a = find(edge.row);
      const int b = find(rows + edge.column);
      if (a != b) parent_[std::max(a, b)] = std::min(a, b);
    }
    label_.assign(rows + columns, kFree);
    local_.assign(rows + columns, 0);
    components_ = 0;
    for (int node = 0; node < rows + columns; ++node) {
      const bool is_row = node < rows;
      if ((is_row ? row_degree_[node] : column_degree_[node - rows]) == 0) continue;
      const int root = find(node);
      if (label_[root] == kFree) {
        label_[root] = components_++;
        if (static_cast<int>(rows_of_.size()) < components_) {
          rows_of_.resize(components_);
          columns_of_.resize(components_);
          edges_of_.resize(components_);
        }
        rows_of_[label_[root]].clear();
        columns_of_[label_[root]].clear();
        edges_of_[label_[root]].clear();
      }
      std::vector<int>& members = is_row ? rows_of_[label_[root]] : columns_of_[label_[root]];
      local_[node] = static_cast<int>(members.size());
      members.push_back(is_row ? node : node - rows);
    }
    for (std::size_t index = 0; index < edges.size(); ++index)
      edges_of_[label_[find(edges[index].row)]].push_back(static_cast<int>(index));
    first_column_ = rows;
  }

  void solve_row(const std::vector<Edge>& edges, const double* unassigned, int component,
                 int* match) {
    const int row = rows_of_[component][0];
    double best = unassigned[row];
    for (const int index : edges_of_[component]) {
      if (edges[index].cost < best) {
        best = edges[index].cost;
        match[row] = edges[index].column;
      }
    }
  }

  // Jonker and Volgenant (1987), augmentation by shortest paths, on a dense matrix that has one
  // private column a row for "left alone".
  bool solve_component(const std::vector<Edge>& edges, const double* unassigned, int component,
                       int* match) {
    const std::vector<int>& rows = rows_of_[component];
    const std::vector<int>& columns = columns_of_[component];
    const int r = static_cast<int>(rows.size());
    const int real = static_cast<int>(columns.size());
    const int c = real + r;
    cost_.assign(static_cast<std::size_t>(r) * c, kInfinity);
    for (const int index : edges_of_[component]) {
      const Edge& edge = edges[index];
      double& cell = cost_[static_cast<std::size_t>(local_[edge.row]) * c +
                           local_[first_column_ + edge.column]];
      cell = std::min(cell, edge.cost);
    }
    for (int i = 0; i < r; ++i)
      cost_[static_cast<std::size_t>(i) * c + real + i] = unassigned[rows[i]];
    u_.assign(r, 0.0);
    v_.assign(c, 0.0);
    column_of_row_.assign(r, kFree);
    row_of_column_.assign(c, kFree);
    for (int row = 0; row < r; ++row)
      if (!augment(row, r, c)) return false;
    for (int i = 0; i < r; ++i)
      match[rows[i]] = column_of_row_[i] < real ? columns[column_of_row_[i]] : kFree;
    return true;
  }

  bool augment(int first, int r, int c) {
    shortest_.assign(c, kInfinity);
    path_.assign(c, kFree);
    row_seen_.assign(r, 0);
    column_seen_.assign(c, 0);
    int row = first;
    int sink = kFree;
    double distance = 0.0;
    while (sink == kFree) {
      row_seen_[row] = 1;
      const double* costs = &cost_[static_cast<std::size_t>(row) * c];
      double lowest = kInfinity;
      int nearest = kFree;
      for (int j = 0; j < c; ++j) {
        if (column_seen_[j]) continue;
        const double through = distance + costs[j] - u_[row] - v_[j];
        if (through < shortest_[j]) {
          shortest_[j] = through;
          path_[j] = row;
        }
        // among equals a free column ends the search at once
        if (shortest_[j] < lowest ||
            (shortest_[j] == lowest && nearest != kFree && row_of_column_[j] == kFree)) {
          lowest = shortest_[j];
          nearest = j;
        }
      }
      if (nearest == kFree) return false;
      distance = lowest;
      column_seen_[nearest] = 1;
      if (row_of_column_[nearest] == kFree) {
        sink = nearest;
      } else {
        row = row_of_column_[nearest];
      }
    }
    u_[first] += distance;
    for (int i = 0; i < r; ++i)
      if (row_seen_[i] && i != first) u_[i] += distance - shortest_[column_of_row_[i]];
    for (int j = 0; j < c; ++j)
      if (column_seen_[j]) v_[j] -= distance - shortest_[j];
    int column = sink;
    while (true) {
      const int i = path_[column];
      row_of_column_[column] = i;
      std::swap(column_of_row_[i], column);
      if (i == first) return true;
    }
  }

  std::vector<int> row_degree_, column_degree_, parent_, label_, local_;
  std::vector<std::vector<int>> rows_of_, columns_of_, edges_of_;
  std::vector<double> cost_, u_, v_, shortest_;
  std::vector<int> path_, column_of_row_, row_of_column_;
  std::vector<char> row_seen_, column_seen_;
  int components_ = 0;
  int first_column_ = 0;
};

}  // namespace assignment
