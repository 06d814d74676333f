// One material for all views: `which` picks the function, `gain` brings it to the colour limit.

const COMMON = /* glsl */ `
  uniform int which;        // 0 exact, 1 predicted, 2 their difference
  uniform float gain;       // scale of the 16 bits / limit of the colours
  uniform float swing;      // cos of the phase; 1 at rest
  uniform float amplitude;  // of the displacement, in sides of the box
`;

export const VERTEX = /* glsl */ `
  ${COMMON}
  uniform float pixels;     // of one unit at distance one; 0 for meshes
  uniform float diameter;   // of a point of a cloud
  attribute float exact;
  attribute float predicted;
  varying float value;
  varying vec3 across;      // normal, in the coordinates of the camera
  varying vec3 place;
  void main() {
    float v = which == 0 ? exact : which == 1 ? predicted : predicted - exact;
    value = v * gain;
    vec3 moved = position + normal * (amplitude * swing * clamp(value, -1.5, 1.5));
    vec4 seen = modelViewMatrix * vec4(moved, 1.0);
    across = normalMatrix * normal;
    place = seen.xyz;
    gl_Position = projectionMatrix * seen;
    gl_PointSize = max(diameter * pixels / -seen.z, 2.0);
  }
`;

export const FRAGMENT = /* glsl */ `
  ${COMMON}
  uniform sampler2D palette;
  uniform float lines;      // half width of nodal lines in pixels; 0 for none
  uniform vec2 depths;      // of the nearest and the farthest point
  uniform bool round;       // points of a cloud
  uniform bool rough;       // few triangles in place of many: some lie the wrong way round
  varying float value;
  varying vec3 across;
  varying vec3 place;

  vec3 linear(vec3 c) { return mix(c / 12.92, pow((c + 0.055) / 1.055, vec3(2.4)), step(0.04045, c)); }
  vec3 encoded(vec3 c) { return mix(12.92 * c, 1.055 * pow(c, vec3(1.0 / 2.4)) - 0.055, step(0.0031308, c)); }

  void main() {
    vec3 view = normalize(-place);
    vec3 n = length(across) > 0.0 ? normalize(across) : view;
    // Faces know their side, points do not; at an outline a normal may lean away without turning.
    if (round || rough ? dot(n, view) < 0.0 : !gl_FrontFacing) n = -n;
    float shade = 1.0;
    if (round) {
      vec2 disc = 2.0 * gl_PointCoord - 1.0;
      float r = dot(disc, disc);
      if (r > 1.0) discard;
      n = normalize(n + 0.28 * vec3(disc.x, -disc.y, sqrt(1.0 - r)));
      shade = mix(1.0, 0.72, smoothstep(depths.x, depths.y, -place.z));
    }
    // A key light from above left, a fill from the right, the sky, all of which turn with the viewer.
    float key = max(dot(n, normalize(vec3(-0.45, 0.70, 0.80))), 0.0);
    float fill = max(dot(n, normalize(vec3(0.85, 0.10, 0.55))), 0.0);
    shade *= 0.30 + 0.10 * n.y + 0.58 * key + 0.20 * fill;
    shade *= mix(0.72, 1.0, smoothstep(-0.1, 0.5, dot(n, view)));
    float gloss = 0.05 * pow(max(dot(n, normalize(normalize(vec3(-0.45, 0.70, 0.80)) + view)), 0.0), 24.0);

    float t = clamp(0.5 + 0.5 * value * swing, 0.0, 1.0) * (255.0 / 256.0) + 0.5 / 256.0;
    vec3 colour = linear(texture2D(palette, vec2(t, 0.5)).rgb) * shade + gloss;

    if (lines > 0.0) {
      float slope = length(vec2(dFdx(value), dFdy(value)));
      // Where the function is flat, its sign is rounding: no line there.
      float steep = slope / max(length(vec2(length(dFdx(place)), length(dFdy(place)))), 1e-9);
      float near = 1.0 - smoothstep(lines - 0.5, lines + 0.5, abs(value) / max(slope, 1e-9));
      colour = mix(colour, vec3(0.012), 0.85 * near * smoothstep(0.02, 0.10, steep));
    }
    gl_FragColor = vec4(encoded(clamp(colour, 0.0, 1.0)), 1.0);
  }
`;
