// Owns the arrays behind a Model: copies Scene.core and derives chains, sparsity patterns and contact groups.
#pragma once
#include <map>
#include <set>
#include <stdexcept>
#include <string>
#include <vector>

#include "model.hpp"

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
  const int* i(const std::string& name, size_t size);
  const double* d(const std::string& name, size_t size);
  void derive_chains();
  void derive_groups();
};

}  // namespace cmbrl
