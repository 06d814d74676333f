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

// CLOUD: round points in place of faces. ROUGH: few triangles in place of many, some of which lie the
// wrong way round. Decided when the program is made: a `discard` anywhere in it keeps hidden
// fragments from being left out early, and on a processor that is half the work.
export const FRAGMENT = /* glsl */ `
  ${COMMON}
  uniform sampler2D palette; // in linear light
  uniform float lines;       // half width of nodal lines in pixels; 0 for none
  uniform vec2 depths;       // of the nearest and the farthest point
  varying float value;
  varying vec3 across;
  varying vec3 place;

  const vec3 KEY = vec3(-0.38987, 0.60647, 0.69311);
  const vec3 FILL = vec3(0.83624, 0.09838, 0.53942);

  // The sRGB curve to within 0.001, by roots: exponentials cost far more on a processor.
  vec3 encoded(vec3 c) {
    vec3 a = sqrt(c), b = sqrt(a), d = sqrt(b);
    return 0.662002687 * a + 0.684122060 * b - 0.323583601 * d - 0.022541147 * c;
  }

  void main() {
    vec3 view = normalize(-place);
    float size = dot(across, across);
    vec3 n = size > 0.0 ? across * inversesqrt(size) : view;
    // Faces know their side, points do not; at an outline a normal may lean away without turning.
    #if defined(CLOUD) || defined(ROUGH)
      if (dot(n, view) < 0.0) n = -n;
    #else
      if (!gl_FrontFacing) n = -n;
    #endif
    float shade = 1.0;
    #ifdef CLOUD
      vec2 disc = 2.0 * gl_PointCoord - 1.0;
      float r = dot(disc, disc);
      if (r > 1.0) discard;
      n = normalize(n + 0.28 * vec3(disc.x, -disc.y, sqrt(1.0 - r)));
      shade = mix(1.0, 0.72, smoothstep(depths.x, depths.y, -place.z));
    #endif
    // A key light from above left, a fill from the right, the sky, all of which turn with the viewer.
    float key = max(dot(n, KEY), 0.0);
    float fill = max(dot(n, FILL), 0.0);
    shade *= 0.30 + 0.10 * n.y + 0.58 * key + 0.20 * fill;
    shade *= mix(0.72, 1.0, smoothstep(-0.1, 0.5, dot(n, view)));
    float g = max(dot(n, normalize(KEY + view)), 0.0);
    g *= g * g;
    g *= g;
    g *= g;
    float gloss = 0.05 * g * g;

    float t = clamp(0.5 + 0.5 * value * swing, 0.0, 1.0) * (255.0 / 256.0) + 0.5 / 256.0;
    vec3 colour = texture2D(palette, vec2(t, 0.5)).rgb * shade + gloss;

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
