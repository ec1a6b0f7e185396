// A page of two sequences has errors, but no bones: what the panel offers for it.

if (doc.error && !doc.rig) {
  ready.then(() => {
    if (!doc.input) return set({ view: "result" });
    $("views").hidden = $("colors").hidden = false;
    for (const name of doc.angles ? ["error", "normals"] : ["error"]) {
      document.querySelector(`[name=color][value=${name}]`).closest("label").hidden = false;
    }
    return set({ view: "side", color: "error" });
  });
}
