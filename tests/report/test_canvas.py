"""Pictures of whatever names a file may hold."""

from tirefit.report.canvas import Picture, save_picture


def test_letters_that_the_font_lacks_are_boxes(tmp_path):
    """No warning, which the tests would make an error, in a file or a notebook."""
    picture = Picture(figsize=(1, 1))
    picture.text(0.1, 0.5, "run \x1b 测试 \N{SNOWMAN WITHOUT SNOW}")
    for name in ("a.png", "a.svg"):
        assert save_picture(picture, tmp_path / name).stat().st_size > 500
    assert picture._repr_png_().startswith(b"\x89PNG")
