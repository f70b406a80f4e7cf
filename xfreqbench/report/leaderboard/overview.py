"""The short form of a report: findings and a few tables, made from records, with links to pages that hold the rest."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import product

from scipy.stats import linregress

from xfreqbench.report.drawing.markdown import ABSENT, heading, literal, number, prose, table, with_interval
from xfreqbench.report.leaderboard.boards import Board, BoardRow, published, short_name
from xfreqbench.report.leaderboard.captions import facts, leak_statement, legend
from xfreqbench.report.leaderboard.columns import BRIEF, columns
from xfreqbench.report.leaderboard.comparison import Comparison, Interval
from xfreqbench.report.leaderboard.tables import ranking_table
from xfreqbench.report.leaderboard.unseen_rooms import ROOMS, rooms_overview
from xfreqbench.runs.records import BenchRecord, RunRecord


def overview_markdown(
    ranked: Sequence[Board],
    benches: Sequence[BenchRecord],
    pages: Mapping[str, str],
    measurements_page: str,
    claims: str,
    worse: str,
) -> str:
    """The generated part of a short report; `pages` holds the link to each page by what it is of.

    `claims` and `worse` are the sections on the paper's claims and on what got worse, or empty.
    """
    scene = main_scene(ranked)
    of_scene = [board for board in ranked if board.scene == scene]
    compared = [_first_comparison(board) for board in main_boards(ranked)]
    first = next((each for each in compared if each.board.scene == scene), None)
    every = {**pages, "measurements": measurements_page}
    links = ", ".join(f"[{heading(name)}]({link})" for name, link in every.items())
    parts = [
        *(_provenance(ranked) if ranked else ()),
        *_findings(compared, of_scene),
        *_main_board(first, compared, pages),
        *_skill_matrix(compared),
        *_other_truths(ranked),
        *rooms_overview(benches, pages.get(ROOMS, "")),
        claims,
        worse,
        f"Every board, measurement and figure: {links}. CSV files beside these pages have every split, metric, "
        "carrier, pair of methods and learning curve.",
        legend(is_short=True),
    ]
    return "\n\n".join(filter(None, parts)) + "\n"


def main_scene(ranked: Sequence[Board]) -> str:
    """The scene with the most records."""
    records = Counter[str]()
    for board in ranked:
        records[board.scene] += len(board.records)
    return max(records, key=lambda scene: (records[scene], scene), default="")


def main_boards(ranked: Sequence[Board]) -> list[Board]:
    """Of the boards of each scene and protocol, which differ in data and budgets, that with most runs but ablations.

    Of two with equally many it is that with more test maps, or traced by solver `image`. A board with ablations alone
    is none of them.
    """
    by_place: dict[tuple[str, str], list[Board]] = {}
    for board in ranked:
        if board.without_ablations.rows:
            by_place.setdefault((board.scene, board.protocol), []).append(board)

    def size(board: Board) -> tuple[int, int, bool]:
        runs = sum(len(row.records) for row in board.without_ablations.rows)
        return runs, board.records[0].num_test, board.settings.get("solver") == "image"

    return [max(boards, key=size) for boards in by_place.values()]


def _first_comparison(board: Board) -> Comparison:
    """The rows of a board without ablations, on the splits of most of their runs."""
    return Comparison(board.without_ablations, board.without_ablations.split_sets()[0])


def _provenance(ranked: Sequence[Board]) -> list[str]:
    known = facts(ranked)
    shown = [f"* {name}: {prose('; '.join(texts))}." for name, texts in known.items() if name != "Commits"]
    shown[-1] += f" Commits: {prose(', '.join(known['Commits']))}."
    return ["\n".join(shown)]


def _fitted(comparison: Comparison) -> list[BoardRow]:
    return [row for row in comparison.rows if not row.is_trivial]


def _skill(comparison: Comparison, row: BoardRow) -> str:
    """The average skill of a row with its interval; a dash where it is unknown."""
    return columns(comparison, ("skill",))[0].cell(row)


def _findings(compared: Sequence[Comparison], of_scene: Sequence[Board]) -> list[str]:
    """What the records say on the five questions that everybody asks, each in a sentence with its intervals."""
    scene = of_scene[0].scene if of_scene else ""
    known = {each.board.protocol: each for each in compared if each.board.scene == scene and _fitted(each)}
    imported = [each for each in compared if each.board.is_imported and _fitted(each)]
    measured = next((each for each in imported if each.board.protocol == "held-out-tx"), None)
    found = [
        *_best(known.get("lofo"), compared),
        *_elsewhere(known.get("held-out-tx"), "At transmitters that were never heard"),
        *_elsewhere(known.get("held-out-block"), "Where whole regions of the room were never heard"),
        *_elsewhere(measured, "On measured maps, at transmitters never heard"),
        *papers_idea(of_scene)[0],
        *_as_it_is(of_scene),
    ]
    numbered = [f"{place}. {sentence}" for place, sentence in enumerate(found, 1)]
    return ["## Findings", "\n".join(numbered)] if found else []


def _best(lofo: Comparison | None, compared: Sequence[Comparison]) -> Iterator[str]:
    if lofo is None:
        return
    first, *others = _fitted(lofo)
    competing = [each for each in compared if first.job.method in [row.job.method for row in _fitted(each)]]
    lost = [each for each in competing if _fitted(each)[0].job.method != first.job.method]
    instead = "; ".join(
        f"`{_fitted(each)[0].short_label}` on {literal(each.board.scene)}, {each.board.protocol}" for each in lost
    )
    second = f" The next, `{others[0].short_label}`, has {_skill(lofo, others[0])}." if others else ""
    at = {
        each.board.scene: row.average(each.splits, each.board.skill)
        for each in compared
        for row in (_fitted(each) if each.board.protocol == "lofo" else ())
        if row.job.method == first.job.method
    }
    lowest = min(at, key=lambda scene: at[scene])
    yield (
        f"At a carrier that was never trained on (`lofo`, {literal(lofo.board.scene)}) `{first.short_label}` is best: "
        f"its skill, the share of the best baseline's error that it removes, is {_skill(lofo, first)}"
        + (f"; its lowest on `lofo` is {number(at[lowest], 3)}, in {literal(lowest)}" if len(at) > 1 else "")
        + f".{second} `{first.short_label}` is first on {len(competing) - len(lost)} of the {len(competing)} "
        f"boards of known rooms on which it was run{f' (else {instead})' if lost else ''}. "
        f"{published()['caution'].get(first.job.method, '')}".rstrip()
    )


def _elsewhere(comparison: Comparison | None, where: str) -> Iterator[str]:
    if comparison is None:
        return
    first, *others = _fitted(comparison)
    trivial = next((row for row in comparison.rows if row.is_trivial), None)
    better = [row for row in (first, *others) if trivial and comparison.beats(row, trivial)]
    beside = f" and `{others[0].short_label}` {_skill(comparison, others[0])}" if others else ""
    verb = "is" if len(better) == 1 else "are"
    yield (
        f"{where} (`{comparison.board.protocol}`) `{first.short_label}` has a skill of {_skill(comparison, first)}"
        f"{beside}; {len(better)} of {1 + len(others)} methods {verb} better than the best baseline."
    )


def papers_idea(of_scene: Sequence[Board]) -> tuple[list[str], list[str]]:
    """What each part of the paper's model adds where it alone is changed, and all that a reduction lacks.

    It is a finding and a section with a table; two empty lists where no part was run alone.
    """
    parts = {
        "the carrier as an input": "sees_carrier=false",
        "learned codes of Gaussians": "latent=0",
        "a spread of footprints for each carrier": "max_spread=1",
    }
    every = "all three"
    rows, intervals = [], dict[str, list[Interval]]()
    for aids, base, other in (
        ("without our aids", ("aided=false",), "fixed-frequency-gs (aided=false)"),
        ("with our aids", (), "fixed-frequency-gs (aided=true)"),  # whose own settings are without a blend
    ):
        label, *lacking = (
            f"xfreq-gs ({', '.join(sorted(options))})" if options else "xfreq-gs"
            for options in (base, *((*base, change) for change in parts.values()))
        )
        others = dict(zip(parts, lacking, strict=True)) | {every: other}
        for place, changes in _changes(of_scene, label, others):
            cells = (with_interval(*changes[part], 4) if part in changes else ABSENT for part in (*parts, every))
            rows.append([f"{aids}, {place}", *cells])
            for part, (_, interval) in changes.items():
                intervals.setdefault(part, []).append(interval)
    if not intervals.keys() & parts.keys():
        return [], []
    where, *first = rows[0]
    said = "; ".join(f"{part} {cell}" for part, cell in zip((*parts, every), first, strict=True))
    known = [intervals.get(part, []) for part in (*parts, every)]
    above = ", ".join(str(sum(low > 0 for low, _ in each)) for each in known)
    below = ", ".join(str(sum(high < 0 for _, high in each)) for each in known)
    finding = (
        "Unblended, `xfreq-gs` differs from `fixed-frequency-gs` in three things; each was taken away alone. It adds "
        f"to the median SSIM, {where}: {said}. The page of the paper's claims has {len(rows)} such rows, of other "
        f"carriers and with our aids: in {above} of them, in the order above, the interval is above zero, in {below} "
        "below."
    )
    caption = (
        "Median SSIM of `xfreq-gs` minus that without the part. *All three*: minus that of `fixed-frequency-gs`. A "
        "dash: not run."
    )
    return [finding], [caption, table(["", *parts, every], rows, prose)]


def _changes(
    of_scene: Sequence[Board], label: str, others: Mapping[str, str]
) -> Iterator[tuple[str, dict[str, tuple[float, Interval]]]]:
    """A row's average median SSIM minus those of others, by what each lacks, with its interval, and where that is.

    On `lofo` it is given within and beyond the trained carriers, on `sparse` for each set of training carriers; each on
    the board that has most of the others, then most splits.
    """
    found: dict[tuple[str, str], list[tuple[int, int, Comparison]]] = {}
    for board in of_scene:
        rows = {row.short_label: row for row in board.rows}
        if board.protocol not in ("lofo", "sparse") or label not in rows:
            continue
        outside = {record.job.split for record in rows[label].records if record.extrapolated_from}
        places: dict[tuple[str, str], list[str]] = {}
        for split in sorted(rows[label].by_split, key=outside.__contains__):
            where = f"`{board.protocol}`" + (" beyond the trained carriers" if split in outside else "")
            places.setdefault((where, split if board.protocol == "sparse" else ""), []).append(split)
        for place, splits in places.items():
            run = [rows[other] for other in others.values() if other in rows and rows[other].by_split.keys() & splits]
            shared = tuple(split for split in splits if run and all(split in row.by_split for row in run))
            if shared:
                found.setdefault(place, []).append((len(run), len(shared), Comparison(board, shared)))
    for (where, _), each in found.items():
        *_, comparison = max(each, key=lambda found: found[:2])
        rows = {row.short_label: row for row in comparison.rows}
        changes = {}
        for what, other in others.items():
            if other in rows:
                change = rows[label].average(comparison.splits) - rows[other].average(comparison.splits)
                changes[what] = change, comparison.difference(rows[label], rows[other])
        yield _on(where, comparison.splits), changes


def _on(where: str, splits: Sequence[str]) -> str:
    """A protocol and the carriers of its splits."""
    return f"{where} at {', '.join(map(short_name, splits))}"


def _as_it_is(of_scene: Sequence[Board]) -> Iterator[str]:
    """How far the paper's method comes with nothing that the paper does not have, beside the aided one."""
    rows = [(board, row) for board in of_scene for row in board.rows if board.protocol == "lofo"]
    as_published = [
        (board, row) for board, row in rows if (row.job.method, row.family) == ("xfreq-gs-paper", "learned")
    ]
    with_aids = [(board, row) for board, row in rows if row.short_label in ("xfreq-gs", "xfreq-gs (aided=true)")]
    for (board, plain), (other, aided) in product(as_published, with_aids):
        splits = Comparison.of(board, plain, aided).splits
        if splits and board.data == other.data:
            more = [
                f"; on {literal(each.data_name)} {_reached(each, row, splits)}"
                for each, row in as_published
                if each.lane != board.lane and set(splits) <= row.by_split.keys()
            ]
            yield (
                "With nothing that the paper does not have (`xfreq-gs-paper`) its method reaches a median SSIM of "
                f"{_reached(board, plain, splits)} on {_on('`lofo`', splits)}{''.join(more)}. With our aids "
                f"(`xfreq-gs`) it has {_reached(other, aided, splits)}."
            )
            return


def _reached(board: Board, row: BoardRow, splits: tuple[str, ...]) -> str:
    """The average median SSIM of a row, its budget and its number of seeds."""
    number = len({record.job.seed for record in row.records})
    value = with_interval(row.average(splits), Comparison(board, splits).interval(row), 4)
    return f"{value} ({board.lane}, {number} seed{'s' * (number > 1)})"


def _main_board(first: Comparison | None, compared: Sequence[Comparison], pages: Mapping[str, str]) -> list[str]:
    """The ranking of the main scene on its first protocol, without columns of splits where these are many.

    Beside it is that in another scene, of several with this protocol that with most boards; below, error against time.
    """
    if first is None:
        return []
    board = first.board
    title, page = heading(" · ".join(filter(None, (board.scene, board.protocol, board.lane_title)))), pages[board.scene]
    said = f"**{leak_statement(board)}** [The other boards]({page})."
    alike = [each for each in compared if each.board.protocol == board.protocol and each is not first and _fitted(each)]
    num_boards, more = Counter(each.board.scene for each in compared), []
    for other in sorted(alike, key=lambda each: -num_boards[each.board.scene])[:1]:
        scene, of_both = other.board.scene, ("rank", "average", "skill", "beam_loss")
        said += f" Columns of {literal(scene)} are {_on('of the board there', other.splits)}."
        more = [column.elsewhere(scene, other.rows) for column in columns(other, of_both)]
    every = (*BRIEF[:2], "whose", *BRIEF[2:-1], "beam_loss", BRIEF[-1])
    shown = [name for name in every if name != "splits" or len(first.splits) <= 5]
    drawn = f"{page.rpartition('/')[0]}/{board.time_figure}".lstrip("/")
    figure = [f"Error against time: ![SSIM against seconds of fitting, {title}]({drawn})"] if board.time_figure else []
    return [f"## {title}\n\n{said}\n\n{ranking_table(first, shown, more=more)}", *figure]


def worth(ranked: Sequence[Board]) -> str:
    """What the best methods and the best baseline have in other units than SSIM, and how much .01 of SSIM is in these.

    That is the slope of a line through all rows of the first board that have a median SSIM of .7 or more.
    """
    comparison = next(map(_first_comparison, main_boards(ranked)), None)
    rows = [row for row in comparison.rows if row.average(comparison.splits) >= 0.7] if comparison else []
    shown = [row for row in rows if not row.is_trivial][:2] + [row for row in rows if row.is_trivial][:1]
    if comparison is None or len(rows) < 5 or not all("beam_loss" in row.records[0].scores for row in rows):
        return ""
    ssim = [row.average(comparison.splits) for row in rows]
    quantities: dict[str, Callable[[RunRecord], float]] = {
        "beam loss, median (dB)": lambda record: record.scores["beam_loss"].median,
        "beam loss that a tenth of the maps exceeds (dB)": lambda record: record.scores["beam_loss"].quantiles[90],
        "error of the map's powers, median (dB)": lambda record: record.scores["power_error"].median,
        "AoA error, median (°)": lambda record: record.scores["aoa_error"].median,
    }
    body = []
    for name, quantity in quantities.items():
        values = [row.average(comparison.splits, quantity) for row in rows]
        slope = linregress(ssim, values).slope
        body.append([name, f"{slope / 100:+.3f}", *(number(values[rows.index(row)], 3) for row in shown)])
    caption = (
        "Maps of a small array are nearly one lobe, so that SSIM is high for most. *Beam loss* is what is lost when "
        f"the beam is chosen from the predicted map. First a line through the {len(rows)} methods from .7 up, "
        f"{literal(comparison.board.scene)}, {comparison.board.protocol}. Records have no error of absolute power, "
        "since maps have a peak of 1."
    )
    header = ["", ".01 of SSIM more", *(row.short_label for row in shown)]
    return f"## What .01 of SSIM is worth\n\n{caption}\n\n{table(header, body)}"


def _skill_matrix(compared: Sequence[Comparison]) -> list[str]:
    """The skill on each board of traced rooms, of the fitted methods that stand on half of these boards or more."""
    compared = [each for each in compared if not each.board.is_imported]
    # of each method the best row, which comes last here
    every = [(each, {row.job.method: row for row in reversed(_fitted(each))}) for each in compared]
    best = [(each, by_method) for each, by_method in every if by_method]
    numbers = Counter(method for _, by_method in best for method in by_method)
    methods = sorted(method for method, number in numbers.items() if 2 * number >= len(best))
    if len(compared) < 2 or not methods:
        return []
    rows = []
    for each, by_method in best:
        (column,) = columns(each, ("skill",))
        cells = [column.text(by_method[method]) if method in by_method else ABSENT for method in methods]
        rows.append([f"{each.board.scene}, {each.board.protocol}", *cells])
    budgets = {each.board.lane_title for each, _ in best}
    budget = f", with the budget {next(iter(budgets))}" if len(budgets) == 1 and any(budgets) else ""
    left_out = ", ".join(f"`{method}`" for method in sorted(numbers.keys() - methods))
    left_out = f" Left out, since on fewer than half of the boards: {left_out}." if left_out else ""
    dash = " A dash: these records have no such run." if any(ABSENT in row for row in rows) else ""
    caption = f"Average skill on the splits of most runs{budget}.{left_out}{dash}"
    return [f"## Skill on every scene and protocol\n\n{caption}\n\n{table(['board', *methods], rows)}"]


def _other_truths(ranked: Sequence[Board]) -> list[str]:
    """Rank and skill of every method on maps that others published, and where a room was traced by several programs."""
    by_place: dict[tuple[str, str, str, int], list[Board]] = {}
    for board in ranked:
        if board.without_ablations.rows:
            by_place.setdefault((board.scene, board.protocol, board.lane, board.records[0].num_test), []).append(board)
    compared = [
        _first_comparison(board)
        for boards in by_place.values()
        for board in boards
        if board.is_imported or len({each.settings.get("solver") for each in boards}) > 1
    ]
    methods = list(dict.fromkeys(row.short_label for each in compared for row in _fitted(each)))
    if not methods:
        return []
    header, baselines, body = [""], ["best baseline"], [[method] for method in methods]
    for each in compared:
        by_label = {row.short_label: row for row in each.rows}
        header.append(
            ", ".join(filter(None, [each.board.scene, each.board.protocol, each.board.settings.get("solver")]))
        )
        best = next((row for row in each.rows if row.is_trivial), None)
        baselines.append(f"{best.short_label} {number(best.average(each.splits), 3)}" if best else ABSENT)
        rank, skill = columns(each, ("rank", "skill"))
        for cells in body:
            row = by_label.get(cells[0])
            cells.append(f"{rank.text(row)}: {skill.cell(row)}" if row else ABSENT)
    caption = (
        "Rank among all methods and baselines, and skill; first the best baseline with its median SSIM. Columns with "
        "a solver are of one room and the same transmitters, those without of maps that others published."
    )
    return [f"## Other truth\n\n{caption}\n\n{table(header, [baselines, *body])}"]
