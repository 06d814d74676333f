// The programs of all views: `which` picks the function, `gain` brings it to the colour limit.

const COMMON = /* glsl */ `
  uniform int which;        // 0 exact, 1 predicted, 2 their difference
  uniform float gain;       // scale of the 16 bits / limit of the colours
  uniform float swing;      // cos of the phase; 1 at rest
  uniform float amplitude;  // of the displacement, in sides of the box
  uniform float lines;      // half width of nodal lines in pixels; 0 for none
`;

// The value at a vertex, and where it is seen.
const SWUNG = /* glsl */ `
  attribute float exact;
  attribute float predicted;
  vec4 swung(out float value) {
    value = gain * (which == 0 ? exact : which == 1 ? predicted : predicted - exact);
    vec3 moved = position + normal * (amplitude * swing * clamp(value, -1.5, 1.5));
    return modelViewMatrix * vec4(moved, 1.0);
  }
`;

// A key light from above left, a fill from the right, the sky, all of which turn with the viewer;
// and the sRGB curve to within 0.001, by roots: exponentials cost far more on a processor.
const LIGHT = /* glsl */ `
  const vec3 KEY = vec3(-0.38987, 0.60647, 0.69311);
  const vec3 FILL = vec3(0.83624, 0.09838, 0.53942);

  float lit(vec3 n, vec3 view) {
    float key = max(dot(n, KEY), 0.0);
    float fill = max(dot(n, FILL), 0.0);
    float shade = 0.30 + 0.10 * n.y + 0.58 * key + 0.20 * fill;
    return shade * mix(0.72, 1.0, smoothstep(-0.1, 0.5, dot(n, view)));
  }

  float glossy(vec3 n, vec3 view) {
    float g = max(dot(n, normalize(KEY + view)), 0.0);
    g *= g * g;
    g *= g;
    g *= g;
    return 0.05 * g * g;
  }

  vec3 encoded(vec3 c) {
    vec3 a = sqrt(c), b = sqrt(a), d = sqrt(b);
    return 0.662002687 * a + 0.684122060 * b - 0.323583601 * d - 0.022541147 * c;
  }
`;

export const VERTEX = /* glsl */ `
  ${COMMON}
  ${SWUNG}
  uniform float pixels;     // of one unit at distance one
  uniform float diameter;   // of a point of a cloud
  varying float value;
  varying vec3 across;      // normal, in the coordinates of the camera
  varying vec3 place;
  void main() {
    vec4 seen = swung(value);
    across = normalMatrix * normal;
    place = seen.xyz;
    gl_Position = projectionMatrix * seen;
    gl_PointSize = max(diameter * pixels / -seen.z, 2.0);
  }
`;

// CLOUD: triangles between the points of a cloud; BALLS: the points, drawn round. Decided when the
// program is made: a `discard` anywhere in it keeps hidden fragments from being left out early, and
// on a processor that is half the work.
export const FRAGMENT = /* glsl */ `
  ${COMMON}
  ${LIGHT}
  uniform sampler2D palette; // in linear light
  uniform vec2 depths;       // of the nearest and the farthest point
  varying float value;
  varying vec3 across;
  varying vec3 place;

  void main() {
    vec3 view = normalize(-place);
    float size = dot(across, across);
    vec3 n = size > 0.0 ? across * inversesqrt(size) : view;
    float fade = 1.0;
    // Faces of a mesh know their side, points do not; at an outline a normal may lean away without turning.
    #ifdef CLOUD
      if (dot(n, view) < 0.0) n = -n;
      #ifdef BALLS
        vec2 disc = 2.0 * gl_PointCoord - 1.0;
        float r = dot(disc, disc);
        if (r > 1.0) discard;
        n = normalize(n + 0.28 * vec3(disc.x, -disc.y, sqrt(1.0 - r)));
      #endif
      fade = mix(1.0, 0.72, smoothstep(depths.x, depths.y, -place.z));
    #else
      if (!gl_FrontFacing) n = -n;
    #endif

    float t = clamp(0.5 + 0.5 * value * swing, 0.0, 1.0) * (255.0 / 256.0) + 0.5 / 256.0;
    vec3 colour = texture2D(palette, vec2(t, 0.5)).rgb * (fade * lit(n, view)) + glossy(n, view);

    #ifndef CLOUD
    if (lines > 0.0) {
      float slope = length(vec2(dFdx(value), dFdy(value)));
      // Where the function is flat, its sign is rounding: no line there.
      float steep = slope / max(length(vec2(length(dFdx(place)), length(dFdy(place)))), 1e-9);
      float near = 1.0 - smoothstep(lines - 0.5, lines + 0.5, abs(value) / max(slope, 1e-9));
      colour = mix(colour, vec3(0.012), 0.85 * near * smoothstep(0.02, 0.10, steep));
    }
    #endif
    gl_FragColor = vec4(encoded(clamp(colour, 0.0, 1.0)), 1.0);
  }
`;

// The same picture of few triangles by as little work for each pixel as can be: light from the
// corners, colours as the screen takes them, looked up without a mean.
export const ROUGH_VERTEX = /* glsl */ `
  ${COMMON}
  ${SWUNG}
  ${LIGHT}
  uniform vec2 depths;
  varying vec3 found;       // value, shade, gloss
  void main() {
    vec4 seen = swung(found.x);
    vec3 view = normalize(-seen.xyz), n = normalMatrix * normal;
    float size = dot(n, n);
    n = size > 0.0 ? n * inversesqrt(size) : view;
    if (dot(n, view) < 0.0) n = -n; // some of few triangles lie the wrong way round
    float shade = lit(n, view);
    #ifdef CLOUD
      shade *= mix(1.0, 0.72, smoothstep(depths.x, depths.y, -seen.z));
    #endif
    found.y = encoded(vec3(shade)).x;
    found.z = 0.7 * glossy(n, view);
    gl_Position = projectionMatrix * seen;
  }
`;

export const ROUGH_FRAGMENT = /* glsl */ `
  ${COMMON}
  uniform sampler2D swatches; // the palette in sRGB
  uniform float pixels;
  varying vec3 found;
  void main() {
    vec3 colour = texture2D(swatches, vec2(0.5 + 0.498 * clamp(found.x * swing, -1.0, 1.0), 0.5)).rgb;
    colour = colour * found.y + found.z;
    vec2 change = vec2(dFdx(found.x), dFdy(found.x));
    float slope = dot(change, change), steep = pixels * gl_FragCoord.w;
    float near = clamp(lines + 0.5 - abs(found.x) * inversesqrt(max(slope, 1e-18)), 0.0, 1.0);
    near *= clamp(150.0 * slope * steep * steep, 0.0, 1.0); // as above: no line where it is flat
    gl_FragColor = vec4(colour * (1.0 - 0.56 * near * min(lines * 10.0, 1.0)), 1.0);
  }
`;

// Nodal lines of a cloud: segments, each a strip that faces the viewer, before the round points
// that overlap it.
export const LINE_VERTEX = /* glsl */ `
  ${COMMON}
  uniform vec2 size;        // of the view in pixels
  uniform float diameter;
  attribute vec2 corner;    // which end, 0 or 1, and which side, -1 or 1
  attribute vec3 start;
  attribute vec3 stop;
  attribute float strength; // thins a line where the function is flat
  vec4 lifted(vec3 end) {
    vec3 seen = (modelViewMatrix * vec4(end, 1.0)).xyz;
    return projectionMatrix * vec4(seen * (1.0 - 0.9 * diameter / length(seen)), 1.0);
  }
  void main() {
    vec4 a = lifted(start), b = lifted(stop);
    vec2 along = (b.xy / b.w - a.xy / a.w) * size;
    along /= max(length(along), 1e-6);
    vec4 end = corner.x > 0.5 ? b : a;
    // A little longer than the segment, so that there are no notches in a bend.
    vec2 out_ = (2.0 * corner.x - 1.0) * along + corner.y * vec2(-along.y, along.x);
    gl_Position = end + vec4(2.0 * lines * strength * out_ / size * end.w, 0.0, 0.0);
  }
`;

export const LINE_FRAGMENT = /* glsl */ `
  void main() {
    gl_FragColor = vec4(vec3(0.36), 1.0); // what nodal lines of meshes come to in middling light
  }
`;
