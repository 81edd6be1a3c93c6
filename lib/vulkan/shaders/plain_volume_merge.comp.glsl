// Volume stage: slabs meet the pixel's array one by one (slab_merge_sink.glsl).
#version 460
#include "cast_plain.glsl"
#include "plain_volume.glsl"
#include "slab_merge_sink.glsl"
#include "plain_volume_cast.glsl"
