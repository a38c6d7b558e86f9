"""The page of `bash jobs/gallery.sh`: of the results in a folder each kind of figure once."""

import sys
from html import escape
from pathlib import Path

import pgran
from pgran.catalogue import FIGURES

folder = Path(sys.argv[1])
page = ['<meta charset="utf-8"><title>Figures of pgran</title><h1>Figures of pgran</h1>']
kinds, groups = set(), set()
for path in sorted(folder.glob("*.h5")):
    result = pgran.load(path)
    groups |= {group for group in FIGURES if hasattr(result, group)}
    made = {(str(result.scene), name): figure for name, figure in pgran.plot(result).items()}
    made = {kind: figure for kind, figure in made.items() if kind not in kinds}
    kinds |= set(made)
    page += [f"<h2>{path.stem}</h2>"] * bool(made)
    page += [f"<pre>{escape(result.attributes['command'])}\npgran plot {path}</pre>"] * bool(made)
    for (_, name), figure in made.items():
        picture = f"{path.stem}-{name}.png"
        figure.savefig(folder / picture, dpi=130)
        caption = f"<figcaption>{escape(figure.caption)}</figcaption>"
        page.append(f'<figure><img src="{picture}" alt="{name}">{caption}</figure>')
(folder / "index.html").write_text("\n".join(page), encoding="utf-8")
print(f"{len(kinds)} kinds of figures: {folder / 'index.html'}")
if missing := sorted(set(FIGURES) - groups):
    sys.exit(f"gallery: no figures of {', '.join(missing)}")
