# What Godot makes of res://model.glb, as shown.mjs says it of three.js: bones, and each clip frame
# by frame, the vertices skinned by this script with the arrays, binds and poses that Godot has.
extends Node

func _ready():
	var clips = JSON.parse_string(FileAccess.get_file_as_string("res://clips.json"))
	var state = GLTFState.new()
	var document = GLTFDocument.new()
	document.append_from_buffer(FileAccess.get_file_as_bytes("res://model.glb"), "", state)
	var scene = document.generate_scene(state, clips.values()[0].fps)
	add_child(scene)
	var player = scene.find_children("*", "AnimationPlayer", true, false)[0]
	var mesh = scene.find_children("*", "MeshInstance3D", true, false)[0]
	var skeleton = mesh.get_node(mesh.skeleton)
	var all = range(skeleton.get_bone_count())
	var bone_name = func(b): return skeleton.get_bone_name(b) if b >= 0 else null
	var out = {
		"version": Engine.get_version_info().string,
		"bones": all.map(func(b): return [bone_name.call(b), bone_name.call(skeleton.get_bone_parent(b))]),
		"joints": all.map(func(b): return numbers(skeleton.get_bone_global_rest(b).origin)),
		"index": [],
		"clips": {},
	}
	for clip in player.get_animation_list():
		var shown = {"duration": player.get_animation(clip).length, "points": [], "locals": []}
		out.clips[clip] = shown
		player.play(clip)
		for t in clips[clip].frames:
			player.seek(t / clips[clip].fps, true)
			shown.points.append(skinned(mesh, skeleton))
			shown.locals.append(all.map(func(b): return matrix(skeleton.get_bone_pose(b))))
	out.influences = mesh.mesh.surface_get_arrays(0)[Mesh.ARRAY_BONES].size() / (out.clips.values()[0].points[0].size() / 3)
	JavaScriptBridge.eval("answer(%s)" % JSON.stringify(JSON.stringify(out, "", true, true)))

func numbers(v):
	return [v.x, v.y, v.z]

# In columns, as three.js has it.
func matrix(m):
	return [m.basis.x, m.basis.y, m.basis.z].reduce(func(a, c): return a + numbers(c) + [0], []) + numbers(m.origin) + [1]

func skinned(mesh, skeleton):
	var arrays = mesh.mesh.surface_get_arrays(0)
	var points = arrays[Mesh.ARRAY_VERTEX]
	var bones = arrays[Mesh.ARRAY_BONES]
	var weights = arrays[Mesh.ARRAY_WEIGHTS]
	var influences = bones.size() / points.size()
	var moved = []
	for k in mesh.skin.get_bind_count():
		var bone = mesh.skin.get_bind_bone(k)
		if bone < 0:
			bone = skeleton.find_bone(mesh.skin.get_bind_name(k))
		moved.append(skeleton.get_bone_global_pose(bone) * mesh.skin.get_bind_pose(k))
	var out = []
	for v in points.size():
		var sum = Vector3()
		for k in range(influences * v, influences * (v + 1)):
			sum += weights[k] * (moved[bones[k]] * points[v])
		out.append_array(numbers(sum))
	return out
