"""Images: stereo pairs out of recordings, and images into them."""

from vmf.data.images.compressed import encoded
from vmf.data.images.raw import Image
from vmf.data.images.stream import ImagePair, StereoImages

__all__ = ["Image", "ImagePair", "StereoImages", "encoded"]
