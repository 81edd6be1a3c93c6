#include "io/mesh_file.hpp"

#include <algorithm>
#include <cmath>
#include <functional>
#include <span>
#include <unordered_map>

#include <assimp/postprocess.h>
#include <assimp/scene.h>
#include <assimp/Importer.hpp>

#include "core/error.hpp"
#include "io/input_file.hpp"
#include "io/mesh_check.hpp"

namespace pellucid {
namespace {

using Path = std::filesystem::path;

Vec3 to_vec3(const aiVector3D& v) {
    return {v.x, v.y, v.z};
}

// assimp's polygons and positions, before anything is computed from them.
void check_scene(const Path& file, const aiScene& scene) {
    for (unsigned m = 0; m < scene.mNumMeshes; ++m) {
        const aiMesh& mesh = *scene.mMeshes[m];
        for (unsigned v = 0; v < mesh.mNumVertices; ++v) {
            const Vec3 p = to_vec3(mesh.mVertices[v]);
            if (!std::isfinite(p.x) || !std::isfinite(p.y) || !std::isfinite(p.z))
                throw input_error("{}: vertex {} = ({}, {}, {}), expected finite numbers (of float32)",
                                  file.string(), v, p.x, p.y, p.z);
        }
        for (unsigned f = 0; f < mesh.mNumFaces; ++f)
            for (unsigned i = 0; i < mesh.mFaces[f].mNumIndices; ++i)
                if (mesh.mFaces[f].mIndices[i] >= mesh.mNumVertices)
                    throw input_error("{}: face {}: vertex index {} out of range, expected 0 to {}",
                                      file.string(), f, mesh.mFaces[f].mIndices[i], mesh.mNumVertices - 1);
    }
}

// What assimp leaves out or makes up without a word shows in the counts.
void check_counts(const Path& file, const aiScene& scene, const MeshCounts& counts) {
    std::uint64_t vertices = 0;
    std::uint64_t faces = 0;
    for (unsigned m = 0; m < scene.mNumMeshes; ++m) {
        vertices += scene.mMeshes[m]->mNumVertices;
        const std::span<const aiFace> all(scene.mMeshes[m]->mFaces, scene.mMeshes[m]->mNumFaces);
        faces += static_cast<std::uint64_t>(
            std::count_if(all.begin(), all.end(), [](const aiFace& face) { return face.mNumIndices >= 3; }));
    }
    if (faces != counts.faces || (counts.shared && vertices != counts.vertices))
        throw input_error("{}: has {} vertices and {} faces, of which {} and {} could be read", file.string(),
                          counts.vertices, counts.faces, vertices, faces);
}

// All meshes of the scene as one, in the order of the file. Lines and points are left out.
void append_node(const aiScene& scene, const aiNode& node, const aiMatrix4x4& parent, bool with_normals,
                 TriangleMesh& out) {
    const aiMatrix4x4 to_world = parent * node.mTransformation;
    const Affine place{Mat3(to_world.a1, to_world.b1, to_world.c1, to_world.a2, to_world.b2, to_world.c2,
                            to_world.a3, to_world.b3, to_world.c3),
                       Vec3(to_world.a4, to_world.b4, to_world.c4)};
    for (unsigned m = 0; m < node.mNumMeshes; ++m) {
        const aiMesh& mesh = *scene.mMeshes[node.mMeshes[m]];
        const auto first = static_cast<std::uint32_t>(out.positions.size());
        for (unsigned v = 0; v < mesh.mNumVertices; ++v) {
            out.positions.push_back(place.point(to_vec3(mesh.mVertices[v])));
            if (with_normals) out.normals.push_back(place.normal(to_vec3(mesh.mNormals[v])));
        }
        for (unsigned f = 0; f < mesh.mNumFaces; ++f) {
            const aiFace& face = mesh.mFaces[f];
            if (face.mNumIndices == 3)
                out.triangles.push_back(
                    {first + face.mIndices[0], first + face.mIndices[1], first + face.mIndices[2]});
        }
    }
    for (unsigned c = 0; c < node.mNumChildren; ++c)
        append_node(scene, *node.mChildren[c], to_world, with_normals, out);
}

struct VertexHash {
    std::size_t operator()(const std::array<double, 6>& key) const {
        std::size_t hash = 0;
        for (const double x : key) hash = 31 * hash + std::hash<double>{}(x);
        return hash ^ (hash >> 29);
    }
};

// Vertices of equal position and normal become one, in order of first use. Equal to the bit, unlike
// assimp's own joining, which would also close gaps of a few units in the last place.
void join_equal_vertices(TriangleMesh& mesh) {
    std::unordered_map<std::array<double, 6>, std::uint32_t, VertexHash> seen;
    TriangleMesh joined;
    std::vector<std::uint32_t> new_index(mesh.positions.size());
    for (std::size_t v = 0; v < mesh.positions.size(); ++v) {
        const Vec3 p = mesh.positions[v] + 0.0;  // −0 becomes 0
        const Vec3 n = mesh.normals.empty() ? Vec3(0.0) : mesh.normals[v] + 0.0;
        const auto [it, is_new] = seen.try_emplace({p.x, p.y, p.z, n.x, n.y, n.z},
                                                   static_cast<std::uint32_t>(joined.positions.size()));
        new_index[v] = it->second;
        if (!is_new) continue;
        joined.positions.push_back(p);
        if (!mesh.normals.empty()) joined.normals.push_back(n);
    }
    for (auto& triangle : mesh.triangles)
        for (std::uint32_t& index : triangle) index = new_index[index];
    mesh.positions = std::move(joined.positions);
    mesh.normals = std::move(joined.normals);
}

// No area: a repeated corner, or a cross product of exactly zero, of edges scaled so that small
// triangles do not vanish by underflow.
bool is_degenerate(const TriangleMesh& mesh, const std::array<std::uint32_t, 3>& t) {
    const Vec3 u = mesh.positions[t[1]] - mesh.positions[t[0]];
    const Vec3 v = mesh.positions[t[2]] - mesh.positions[t[0]];
    const auto largest = [](const Vec3& e) {
        return std::max({std::abs(e.x), std::abs(e.y), std::abs(e.z)});
    };
    if (largest(u) == 0 || largest(v) == 0) return true;
    return cross(u / largest(u), v / largest(v)) == Vec3(0.0);
}

void drop_degenerate(const Path& file, TriangleMesh& mesh) {
    const std::size_t before = mesh.triangles.size();
    std::erase_if(mesh.triangles, [&](const auto& t) { return is_degenerate(mesh, t); });
    if (mesh.triangles.empty())
        throw input_error("{}: no triangle with an area ({} without), expected a mesh", file.string(),
                          before);
    if (mesh.triangles.size() < before)
        warn("{}: {} of {} triangles have no area and are left out", file.string(),
             before - mesh.triangles.size(), before);
}

// Unit length for all, or none at all: half a set would light half the mesh.
void normalise_normals(const Path& file, TriangleMesh& mesh) {
    if (mesh.normals.empty()) return;
    std::vector<bool> used(mesh.positions.size(), false);
    for (const auto& triangle : mesh.triangles)
        for (const std::uint32_t index : triangle) used[index] = true;
    std::size_t bad = 0;
    for (std::size_t v = 0; v < mesh.normals.size(); ++v) {
        const double size = length(mesh.normals[v]);
        const bool usable = size > 0 && std::isfinite(size);
        if (!usable && used[v]) ++bad;
        mesh.normals[v] = usable ? mesh.normals[v] / size : Vec3(0, 0, 1);
    }
    if (bad == 0) return;
    warn("{}: {} of {} normals are zero, NaN or infinite: normals of the file are not used", file.string(),
         bad, mesh.normals.size());
    mesh.normals.clear();
}

// assimp takes a comment behind a face for more of its corners.
void blank_comments(std::string& text) {
    for (std::size_t at = text.find('#'); at != std::string::npos; at = text.find('#', at)) {
        const std::size_t end = std::min(text.find_first_of("\r\n", at), text.size());
        std::fill(text.begin() + static_cast<std::ptrdiff_t>(at),
                  text.begin() + static_cast<std::ptrdiff_t>(end), ' ');
    }
}

bool all_have_normals(const Path& file, const aiScene& scene) {
    unsigned with = 0;
    for (unsigned m = 0; m < scene.mNumMeshes; ++m) with += scene.mMeshes[m]->HasNormals() ? 1U : 0U;
    if (with != 0 && with != scene.mNumMeshes)
        warn("{}: {} of {} parts have normals: normals of the file are not used", file.string(), with,
             scene.mNumMeshes);
    return with == scene.mNumMeshes;
}

}  // namespace

TriangleMesh read_mesh(const Path& file) {
    const std::string extension = lower_extension(file);
    std::string bytes = read_input_file(file);
    const MeshCounts counts = check_mesh(file, extension, bytes);
    if (extension == ".obj") blank_comments(bytes);

    Assimp::Importer importer;
    TriangleMesh mesh;
    try {
        // From memory: what was checked is what is read. Triangulated in a second step, which trusts indices.
        const aiScene* scene =
            importer.ReadFileFromMemory(bytes.data(), bytes.size(), 0, extension.c_str() + 1);
        if (scene == nullptr)
            throw input_error("{}: not a readable mesh: {}", file.string(),
                              one_line(importer.GetErrorString()));
        check_scene(file, *scene);
        check_counts(file, *scene, counts);
        scene = importer.ApplyPostProcessing(aiProcess_Triangulate);
        if (scene == nullptr) throw input_error("{}: polygons cannot be cut into triangles", file.string());
        // STL's normals are those of facets
        append_node(*scene, *scene->mRootNode, aiMatrix4x4(),
                    extension != ".stl" && all_have_normals(file, *scene), mesh);
    } catch (const std::bad_alloc&) {
        throw input_error("{}: does not fit in memory", file.string());
    }
    if (mesh.positions.size() > UINT32_MAX) throw input_error("{}: more than 2^32 vertices", file.string());
    drop_degenerate(file, mesh);
    normalise_normals(file, mesh);
    if (!counts.shared) join_equal_vertices(mesh);
    return mesh;
}

}  // namespace pellucid
