// Height fields: a prism under each of the two triangles of a cell, as MuJoCo has them; and which of them are near a shape. No other
// cell is looked at.
#pragma once
#include "collision/hull_depth.hpp"

namespace cmbrl::CMBRL_ISA {

// A field in the world: heights above a corner of its base, along its own axes, by rows along the second one.
struct PosedField {
  Point corner, axis[3];
  double step[2];
  int rows, columns;
  const double* heights;

  PosedField(const Model& m, int hull, const Point& origin) {
    const double *box = m.hull_box + 15 * hull, *half = box + 12;
    int field = m.hull_field[hull];
    rows = m.field_size[2 * field];
    columns = m.field_size[2 * field + 1];
    heights = m.field_height + m.field_ptr[field];
    for (int j = 0; j < 3; ++j) {
      corner.x[j] = box[j] - origin.x[j];
      for (int k = 0; k < 3; ++k) {
        axis[k].x[j] = box[3 + 3 * k + j];
        corner.x[j] -= half[k] * axis[k].x[j];
      }
    }
    step[0] = 2 * half[0] / (columns - 1);
    step[1] = 2 * half[1] / (rows - 1);
  }
  double height(int r, int c) const { return heights[r * columns + c]; }
  Point base(int r, int c) const { return corner + (c * step[0]) * axis[0] + (r * step[1]) * axis[1]; }
  Point top(int r, int c) const { return base(r, c) + height(r, c) * axis[2]; }
};

// One of the two triangles of a cell, against the clock from the first corner on as seen from above, and the prism under it.
struct Prism {
  int row[3], column[3];
  double point[18], columns[3 * Model::hull_width], normal[15];  // of the base, then of the top; normals as the prism's sides stand in the model

  Prism(const PosedField& f, int r, int c, int which) {
    const int dr[2][3] = {{1, 0, 1}, {0, 0, 1}}, dc[2][3] = {{0, 0, 1}, {0, 1, 1}};
    for (int k = 0; k < 3; ++k) {
      row[k] = r + dr[which][k];
      column[k] = c + dc[which][k];
      set(k, f.base(row[k], column[k]));
      set(3 + k, f.top(row[k], column[k]));
    }
    set_normal(0, unit(cross(corner(4) - corner(3), corner(5) - corner(3))));
  }
  // What only a shape needs that is not above the triangle.
  void complete(const PosedField& f) {
    for (int k = 0; k < 3; ++k) set_normal(2 + k, unit(cross(corner((k + 1) % 3) - corner(k), f.axis[2])));
    set_normal(1, -1.0 * f.axis[2]);
    for (int j = 0; j < 3; ++j)
      for (int k = 0; k < Model::hull_width; ++k) columns[j * Model::hull_width + k] = point[3 * (k < 6 ? k : 5) + j];
  }
  Point corner(int k) const { return {{point[3 * k], point[3 * k + 1], point[3 * k + 2]}}; }
  Point up() const { return {{normal[0], normal[1], normal[2]}}; }
  PosedHull hull(const Model& m, double reach) const {
    PosedHull H;
    H.m = &m;
    H.kind = kPolytope;
    H.reach = reach;
    H.begin = H.first_point = m.hull_ptr[m.prism];
    H.first_face = m.vertex_face[m.vertex_ptr[H.begin + 3]];  // its top, which is the first around the first corner of it
    H.vertices = 6;
    H.count = Model::hull_width;
    H.points = point;
    H.normals = normal;
    H.columns = columns;
    H.starts = nullptr;
    H.made = nullptr;
    H.nmade = 0;
    H.p = {};
    H.bound = nullptr;
    for (int k = 0; k < 9; ++k) H.R[k] = k % 4 == 0;
    return H;
  }

 private:
  void set(int k, const Point& x) { for (int j = 0; j < 3; ++j) point[3 * k + j] = x.x[j]; }
  void set_normal(int k, const Point& x) { for (int j = 0; j < 3; ++j) normal[3 * k + j] = x.x[j]; }
};

// Which triangles a shape may touch, by the box around it.
struct Range {
  int first[2], last[2];  // cells along the field's axes, the last one not among them
  double low;             // what is lower than this is not touched
  Point across;           // from the diagonals of all cells towards their first triangles
  double least, most;     // of the shape, along it

  Range(const PosedHull& A, const PosedField& f) {
    auto from = [&](const Point& d) { return -A.at_most(-1.0 * d) - A.reach - dot(d, f.corner); };
    auto to = [&](const Point& d) { return A.at_most(d) + A.reach - dot(d, f.corner); };
    for (int k = 0; k < 2; ++k) {
      double cells = (k ? f.rows : f.columns) - 1, begin = from(f.axis[k]) / f.step[k], end = to(f.axis[k]) / f.step[k];
      first[k] = int(__builtin_fmin(__builtin_fmax(begin, 0), cells));
      last[k] = int(__builtin_ceil(__builtin_fmin(__builtin_fmax(end, 0), cells)));
    }
    low = from(f.axis[2]);
    across = unit(f.step[0] * f.axis[1] - f.step[1] * f.axis[0]);
    least = from(across);
    most = to(across);
  }
  bool reaches(const PosedField& f, int r, int c) const {
    return __builtin_fmax(__builtin_fmax(f.height(r, c), f.height(r, c + 1)), __builtin_fmax(f.height(r + 1, c), f.height(r + 1, c + 1))) >= low;
  }
  bool meets(const PosedField& f, int r, int c, int which) const {
    double diagonal = dot(across, f.base(r, c) - f.corner);
    return which ? least <= diagonal : most >= diagonal;
  }
};

}  // namespace cmbrl::CMBRL_ISA
