// The parts of three.js that the viewer uses; esbuild leaves out the rest.
export {
  ACESFilmicToneMapping, AmbientLight, ArrowHelper, BufferAttribute, BufferGeometry, CircleGeometry, Color, ConeGeometry,
  CylinderGeometry, DataTexture, DirectionalLight, DoubleSide, EdgesGeometry, Fog, Group, HemisphereLight, Line, LineBasicMaterial,
  LineLoop, LineSegments, LinearFilter, LinearMipmapLinearFilter, MOUSE, Mesh, MeshBasicMaterial, MeshLambertMaterial, MeshStandardMaterial,
  PerspectiveCamera, PlaneGeometry, Points, PointsMaterial, RGBAFormat, RepeatWrapping, RingGeometry, SRGBColorSpace, Scene, Vector2, Vector3, WebGLRenderer,
} from "three";
export { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
