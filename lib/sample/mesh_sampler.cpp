#include "sample/mesh_sampler.hpp"

namespace pellucid {

Object with_triangles(const Object& object, TriangleMesh mesh) {
    Object copy = object;
    copy.geometry = make_mesh_geometry(std::move(mesh));
    return copy;
}

MeshSampler::MeshSampler(const Object& object, TriangleMesh mesh, const Camera& camera, std::uint32_t object_id,
                         std::string complaint)
    : object_(std::make_unique<Object>(with_triangles(object, std::move(mesh)))),
      lines_(std::make_unique<LineSampler>(*object_, camera, object_id)),
      complaint_(std::move(complaint)) {}

}  // namespace pellucid
