"""What this process knows of a bucket: it asks once, so that a command sees one state of it."""

from __future__ import annotations

from bisect import bisect_left
from functools import cache
from pathlib import Path, PurePosixPath

from robotctl.store.folder_store import FolderStore
from robotctl.store.hash_folders import without_hashes
from robotctl.store.range_cache import RangeCache
from robotctl.store.range_reader import RangeReader
from robotctl.store.remote_store import RemoteStore
from robotctl.store.store_errors import NoSuchObject
from robotctl.store.stored_object import StoredObject
from robotctl.store.url import parse_url


@cache
def opened_bucket(root_url: str) -> OpenedBucket:
    """Return what is known of a bucket; every command of this process shares it."""
    return OpenedBucket(root_url)


class OpenedBucket:
    """The objects of a bucket by their paths, which are their names without folders of hashes.

    Of several objects with one path, it is the newest. If an object is replaced after it was found,
    reading it is an error.
    """

    def __init__(self, root_url: str) -> None:
        """Open it; nothing is asked yet.

        Raises:
            UsageError: The library is missing.
        """
        url = parse_url(root_url)
        here = url.scheme == "file"
        self._store = FolderStore(Path("/", url.host)) if here else RemoteStore(url)
        self._known: dict[str, StoredObject | None] = {}
        self._listed: dict[str, list[str]] = {}
        self._readers: dict[str, RangeReader] = {}
        self._cache = RangeCache()

    def found(self, path: str) -> StoredObject | None:
        """Return the object at a path; None if there is none."""
        if path not in self._known:
            folder, _, name = path.rpartition("/")
            listed = self._listing_above(path) is not None
            self._known[path] = None if listed else self._asked(path)
            if self._known[path] is None and "." in name:  # perhaps below the folder of a hash
                self.below(folder)
        return self._known[path]

    def below(self, folder: str) -> list[str]:
        """Return the paths of the objects below a folder, sorted and without that folder."""
        if folder not in self._listed:
            if (above := self._listing_above(folder)) is not None:
                return self._part_of(above, folder)
            found = list(self._store.list(folder)) if self._store.can_list else []
            skipped = len(folder) + 1 if folder else 0
            paths: dict[str, StoredObject] = {}
            for each in sorted(found, key=lambda each: each.modified_ns):
                paths[without_hashes(each.key[skipped:])] = each
            for parent in {str(above) for path in paths for above in PurePosixPath(path).parents}:
                paths.pop(parent, None)  # an empty object that a console shows as a folder
            self._listed[folder] = sorted(paths)
            self._known |= {f"{folder}/{path}".lstrip("/"): each for path, each in paths.items()}
        return self._listed[folder]

    def _listing_above(self, path: str) -> str | None:
        """Return a listed folder that the path is below, None if there is none."""
        folder = path if self._store.can_list else ""
        while folder:
            folder = folder.rpartition("/")[0]
            if folder in self._listed:
                return folder
        return None

    def _part_of(self, above: str, folder: str) -> list[str]:
        """Return what the listing of a folder says of one below it."""
        listed = self._listed[above]
        prefix = f"{folder.removeprefix(above).lstrip('/')}/"
        begin = bisect_left(listed, prefix)
        end = bisect_left(listed, f"{prefix[:-1]}0")  # "0" follows "/"
        return [path[len(prefix) :] for path in listed[begin:end]]

    def reader(self, path: str) -> RangeReader:
        """Return the reader of an object, which keeps some of what it has read.

        Raises:
            NoSuchObject: There is none.
        """
        if path not in self._readers:
            found = self.found(path)
            if found is None:
                raise self.no_such(path)
            self._readers[path] = RangeReader(
                found.size_bytes,
                lambda begin, end: self._store.start_range(found, begin, end),
                self._cache,
            )
        return self._readers[path]

    def check(self, path: str) -> None:
        """Raise what has kept a file, or one below a folder, from being read, if anything has.

        Raises:
            StoreError: A read has failed.
        """
        for each in (path, *(f"{path}/{name}" for name in self.below(path))):
            if (reader := self._readers.get(each)) is not None:
                reader.check()

    def no_such(self, path: str) -> NoSuchObject:
        """Return the error for a path with nothing there."""
        is_folder = "." not in path.rpartition("/")[2]
        on_server = is_folder and not self._store.can_list
        cure = "name the file: a server lists no folders" if on_server else "check the URL"
        return NoSuchObject(f"{self._store.name}/{path} does not exist", cure)

    def _asked(self, path: str) -> StoredObject | None:
        try:
            return self._store.head(path)
        except NoSuchObject:
            return None
