// Owns the arrays behind a Model: copies Scene.core and derives chains, sparsity patterns and contact groups.
#pragma once
#include <cstdint>
#include <map>
#include <stdexcept>
#include <string>
#include <vector>

#include "scene/model.hpp"

namespace cmbrl {

class SceneData {
 public:
  Model model{};

  // ints and doubles by name, exactly as Scene.core holds them
  SceneData(std::map<std::string, std::vector<int>> ints, std::map<std::string, std::vector<double>> doubles,
            const std::map<std::string, int>& sizes);

 private:
  std::map<std::string, std::vector<int>> ints_;
  std::map<std::string, std::vector<double>> doubles_;
  std::vector<uint64_t> world_;
  std::vector<double> cluster_reach_;  // of each, its largest sum of radii and margin
  const int* i(const std::string& name, size_t size);
  const double* d(const std::string& name, size_t size);
  const int* keep_ints(const std::string& name, std::vector<int> x);
  const double* keep_doubles(const std::string& name, std::vector<double> x);
  void derive_parameters();
  void derive_chains();
  std::vector<int> chain(int body) const;
  void derive_lines();
  void derive_segments();
  void derive_linkages();
  void derive_ties();
  void derive_mass_pattern();
  void derive_groups();
  void derive_pairs();
  void derive_hulls(int count);
  void derive_spheres();
  void order_groups();
  void derive_clusters();
  void derive_bundles();
  bool of_a_bundle(int candidate) const;
  struct Bundles;
  int bundle(Bundles& bundles, int begin, int end) const;
  void derive_kins();
  void derive_grips();
};

}  // namespace cmbrl
