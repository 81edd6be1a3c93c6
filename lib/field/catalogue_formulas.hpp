// The part of the catalogue that is formulas; used by catalogue.cpp only.
#pragma once

#include <span>

#include "field/catalogue.hpp"

namespace pellucid {

[[nodiscard]] std::span<const CatalogueEntry> catalogue_formulas();

}  // namespace pellucid
