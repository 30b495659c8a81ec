// The gel of a sensor in 3D on the sensor's page, coloured by what its faces do; the drawing stays without WebGL.

import { BufferAttribute, Color, EdgesGeometry, LineBasicMaterial, LineSegments, Mesh, MeshStandardMaterial, SphereGeometry, SRGBColorSpace } from "three";

import { Studio } from "./studio.js";
import { geometryOf, INK, View } from "./view.js";

const COLOURS = [0xccd1d6, 0xd99e59, 0x5c9eb8]; // neither, driven, sensing: as in player.css
const MARKER = new SphereGeometry(0.3, 12, 8);
const MARKER_MATERIAL = new MeshStandardMaterial({ color: 0x1d232a, roughness: 0.8 });
const VIEW_DEG = [-60, 40];

class Gel extends View {
  constructor(canvas, { vertices_mm: vertices, triangles, kinds, markers_mm: markers, height_scale: heightScale }) {
    super(canvas);
    const positions = { values: new Float32Array(vertices.flatMap(([x, y, z]) => [x, y, heightScale * z])) };
    const shared = geometryOf(positions, { values: new Uint16Array(triangles.flat()) });
    const faces = shared.toNonIndexed();
    const colours = kinds.flatMap((kind) => {
      const colour = new Color().setHex(COLOURS[kind], SRGBColorSpace).toArray();
      return [...colour, ...colour, ...colour];
    });
    faces.setAttribute("color", new BufferAttribute(new Float32Array(colours), 3));
    const mesh = new Mesh(faces, new MeshStandardMaterial({ vertexColors: true, flatShading: true, roughness: 0.6 }));
    mesh.add(new LineSegments(new EdgesGeometry(faces, 0), new LineBasicMaterial({ color: INK, transparent: true, opacity: 0.35 })));
    mesh.castShadow = true;
    for (const [x, y, z] of markers) mesh.add(markerAt(x, y, heightScale * z));
    this.scene.add(mesh);
    faces.computeBoundingBox();
    faces.computeBoundingSphere();
    const { min } = faces.boundingBox;
    new Studio(this, faces.boundingSphere, min.z, () => this.draw());
    this.lookAt(faces.boundingSphere, VIEW_DEG);
  }
}

function markerAt(x, y, z) {
  const marker = new Mesh(MARKER, MARKER_MATERIAL);
  marker.position.set(x, y, z);
  return marker;
}

/** Puts the turnable gel in the place of the drawing. */
export async function showGel(section) {
  const answer = await fetch(section.dataset.shape);
  if (!answer.ok) throw new Error(`Expected the gel at ${section.dataset.shape}, got status ${answer.status}.`);
  const shape = await answer.json();
  const canvas = section.querySelector("canvas.scene");
  canvas.hidden = false;
  try {
    new Gel(canvas, shape);
  } catch {
    canvas.hidden = true;
    section.querySelector(".player-status").textContent = "This browser shows no WebGL, so the gel is a still picture.";
    return;
  }
  section.querySelector(".still").classList.add("printed");
}
