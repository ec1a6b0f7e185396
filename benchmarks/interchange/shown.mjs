// Bones of a loaded glTF, and each clip frame by frame, as three.js has them in node or a browser.
import * as THREE from 'three';

export function shown(gltf, clips) {
  const meshes = [], bones = [];
  gltf.scene.traverse(o => { if (o.isMesh) meshes.push(o); if (o.isBone) bones.push(o); });
  const name = o => o.userData.name || o.name;
  const binds = new Map();
  for (const { skeleton } of meshes.filter(m => m.isSkinnedMesh))
    skeleton.bones.forEach((b, k) => binds.set(b, skeleton.boneInverses[k].clone().invert()));
  const out = {
    bones: bones.map(b => [name(b), b.parent.isBone ? name(b.parent) : null]),
    joints: bones.map(b => new THREE.Vector3().setFromMatrixPosition(binds.get(b)).toArray()),
    index: meshes.flatMap(m => Array.from(m.geometry.getAttribute('_vertex')?.array ?? [])),
    clips: {},
  };
  const v = new THREE.Vector3();
  for (const clip of gltf.animations) {
    const { fps, frames } = clips[clip.name];
    const mixer = new THREE.AnimationMixer(gltf.scene);
    const action = mixer.clipAction(clip);
    action.setLoop(THREE.LoopOnce); action.clampWhenFinished = true; action.play();
    const seen = out.clips[clip.name] = { duration: clip.duration, points: [], locals: [] };
    for (let t = 0; t < frames; t++) {
      mixer.setTime(Math.min(t / fps, clip.duration)); gltf.scene.updateMatrixWorld(true);
      seen.locals.push(bones.map(b => b.matrix.toArray()));
      const points = [];
      for (const mesh of meshes) for (let i = 0; i < mesh.geometry.attributes.position.count; i++) {
        mesh.getVertexPosition(i, v); v.applyMatrix4(mesh.matrixWorld); points.push(v.x, v.y, v.z);
      }
      seen.points.push(points);
    }
    action.stop(); mixer.uncacheClip(clip);
  }
  return out;
}
