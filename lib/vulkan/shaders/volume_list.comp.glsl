// Volume stage with all slabs kept (slab_list.glsl): tests.
#version 460
#include "cast_volume.glsl"
#include "slab_list.glsl"
#include "volume_cast.glsl"
