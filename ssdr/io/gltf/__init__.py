"""glTF 2.0 (``.glb``, ``.gltf``): skins, morph targets and moving nodes."""
