// Unpacks maps and scripts; for the encoding see scenetruth.scoring.report.map_packing.

async function inflate(text) {
  const letters = atob(text), bytes = new Uint8Array(letters.length);
  for (let n = 0; n < letters.length; n++) bytes[n] = letters.charCodeAt(n);
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

async function unpack(packed) {
  const {width, height} = packed, size = width * height;
  const content = await inflate(packed.data);
  const exact = new DataView(content.buffer, content.byteOffset + 2 * size);
  const values = new Float64Array(size), above = new Uint16Array(width);
  let place = 0;
  for (let y = 0, n = 0; y < height; y++) {
    let along = 0;
    for (let x = 0; x < width; x++, n++) {
      const zigzag = (content[n] << 8) | content[size + n];
      let code = (zigzag >>> 1) ^ -(zigzag & 1);
      if (packed.predictor >= 1) code = along = (along + code) & 65535;
      if (packed.predictor === 2) code = above[x] = above[x] + code;
      code &= 65535;
      values[n] = code === 0 ? NaN : code === 1 ? exact.getFloat64(8 * place++, true) : packed.low + (code - 2) * packed.step;
    }
  }
  return {width, height, values, quantum: packed.step};
}
