"""From surfaces in space to flat pictures: camera, visibility, outlines, sections and shading."""
