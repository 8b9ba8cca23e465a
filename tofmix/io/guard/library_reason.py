"""Error of the HDF5 library, in one short line."""


def library_reason(error: BaseException) -> str:
    """Shorten the HDF5 library's message to its reason: the text in its last brackets."""
    text = " ".join(str(error).split()) or type(error).__name__
    if "truncated file" in text or "bad byte number" in text:
        return "truncated HDF5 file; the rest of it is missing"
    return text[text.rfind("(") + 1 : -1] if text.endswith(")") else text
