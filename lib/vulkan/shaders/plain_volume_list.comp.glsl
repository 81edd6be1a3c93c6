// Volume stage in double with all slabs kept (slab_list.glsl): tests.
#version 460
#include "cast_plain.glsl"
#include "plain_volume.glsl"
#include "slab_list.glsl"
#include "plain_volume_cast.glsl"
