// Nets for one instruction set (CMBRL_ISA).
#include "nets/net.hpp"

namespace cmbrl::CMBRL_ISA {

extern const NetBackend net_backend;
const NetBackend net_backend = {net_forward, net_backward};

}  // namespace cmbrl::CMBRL_ISA
