"""The verdict and all pictures of one inspected scan in one PNG file."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path

from PIL import Image, ImageDraw, ImageFont

from pcretrieve.draw import Colour, rgb
from pcretrieve.inspection.inspection import Inspection
from pcretrieve.pages.inspection_pictures import CUT, PICTURE_PIXELS, inspection_cameras, rows_of
from pcretrieve.values.files import write_file

__all__ = ["write_inspection_png"]


def write_inspection_png(inspection: Inspection, path: str | Path) -> Path:
    """Write the verdict and all pictures into one picture. An existing file is replaced in one step."""
    target = Path(path).absolute()
    rows = rows_of(inspection)
    margin, line, title = 16, 22, 34
    width = 2 * margin + len(inspection_cameras(inspection) or [0] * 4) * PICTURE_PIXELS
    lines = [check for check in inspection.checks if check.verdict != "passed"]
    height = 3 * margin + title + line * (1 + len(lines))
    height += sum(row.pictures[0].height + 2 * line + margin for row in rows)
    sheet = Image.new("RGB", (width, height), "white")
    pen = ImageDraw.Draw(sheet)

    def write(text: str, x: int, y: int, size: int, colour: Colour = (0.1, 0.1, 0.1)) -> None:
        font = ImageFont.load_default(size)
        while text and pen.textlength(text, font) > width - margin - x:
            text = text[:-2].rstrip("…") + "…" if len(text) > 2 else ""
        pen.text((x, y), text, rgb(colour), font)

    write(inspection.name, margin, margin, 24)
    y = margin + title
    write(inspection.summary, margin, y, 16, CUT if inspection.verdict == "failed" else (0.1, 0.1, 0.1))
    for check in lines:
        y += line
        write(f"{check.verdict}: {check.name}: {check.shown}. {check.words}", margin, y, 14, (0.3, 0.3, 0.3))
    y += line + margin
    for row in rows:
        write(row.title, margin, y, 16)
        x = margin
        for colour, words in row.key:
            pen.rectangle((x, y + line + 4, x + 10, y + line + 14), rgb(colour))
            write(words, x + 16, y + line, 13, (0.3, 0.3, 0.3))
            x += 36 + round(pen.textlength(words, ImageFont.load_default(13)))
        y += 2 * line
        for column, picture in enumerate(row.pictures):
            sheet.paste(picture, (margin + column * PICTURE_PIXELS, y), picture)
        y += row.pictures[0].height + margin
    file = BytesIO()
    sheet.save(file, "PNG")
    write_file(target, file.getvalue())
    return target
