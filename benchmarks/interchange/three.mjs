// What three.js makes of a .glb: its bones, and each clip frame by frame, as JSON.
//
//     node three.mjs FILE.glb '{"clip": {"fps": 24, "frames": 72}}'
//
// Pictures are not loaded; everything else is three.js's own, as in a browser.
import { readFile } from 'node:fs/promises';
import * as THREE from 'three';
import { GLTFLoader } from 'three/addons/loaders/GLTFLoader.js';
import { shown } from './shown.mjs';

globalThis.self = globalThis;
const [, , file, wanted] = process.argv;
const loader = new GLTFLoader();
loader.register(() => ({ name: 'no pictures', loadTexture: async () => new THREE.Texture() }));
const data = await readFile(file);
const gltf = await loader.parseAsync(data.buffer.slice(data.byteOffset, data.byteOffset + data.length), '');
process.stdout.write(JSON.stringify(shown(gltf, JSON.parse(wanted))));
