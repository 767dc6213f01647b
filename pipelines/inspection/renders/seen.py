"""Renders that come nearer to the captured frames than noise and codec let a perfect one: whoever made them has seen the view."""

from ggvs_eval.pipelines.inspection.finding import Finding, verdict_of

QUESTION = "test view seen"
COMPARED = "PSNR"  # whose ceiling was checked
# Of 192 predictions of what perfect renders score none was off by more than 1 dB.
LIKELY_DB, CERTAIN_DB = 1.0, 2.0


def find_seen(view: str, psnr_db: float, ceiling_db: float) -> list[Finding]:
    """Compare the PSNR of a view with that of a perfect rendering, which lacks the noise of the captured frames.

    A method that was trained on the view, started from it or has it among its sources repeats some of that noise.

    Args:
        view: name.
        psnr_db: of its renders, mean over the frames.
        ceiling_db: of the scene without noise, an estimate or an upper bound, see `ggvs_eval.metrics.ceilings`.

    Examples:
        >>> [find_seen("cam00", psnr, 37.0)[0].verdict for psnr in (38.5, 40.0)]
        ['likely', 'certain']
    """
    beyond_db = psnr_db - ceiling_db
    if not beyond_db > LIKELY_DB:
        return []
    measured = f"PSNR {psnr_db:.1f} dB, a perfect rendering without the camera's noise and codec has {ceiling_db:.1f} dB"
    advice = "was the view among what the method was trained on, fitted to or started from? hold it out there too"
    values = {"psnr_db": psnr_db, "ceiling_db": ceiling_db}
    return [Finding(view, QUESTION, verdict_of(beyond_db > CERTAIN_DB), measured, values, advice)]
