// Prints what an OpenIGTLink server sends, by the reference library: `igtl_receive HOST PORT COUNT`, a line a message.

#include <cstdio>
#include <cstdlib>

#include <igtlClientSocket.h>
#include <igtlMessageHeader.h>
#include <igtlPolyDataMessage.h>
#include <igtlSensorMessage.h>
#include <igtlStatusMessage.h>
#include <igtlStringMessage.h>
#include <igtlTransformMessage.h>

template <class Message>
typename Message::Pointer receive(igtl::ClientSocket* socket, igtl::MessageHeader* header) {
    typename Message::Pointer message = Message::New();
    message->SetMessageHeader(header);
    message->AllocatePack();
    bool timeout(false);
    socket->Receive(message->GetPackBodyPointer(), message->GetPackBodySize(), timeout);
    const int found = message->Unpack(1);  // 1: look at the check sum
    if (!(found & igtl::MessageHeader::UNPACK_BODY)) {
        std::printf("BAD %s\n", header->GetDeviceName());
        std::exit(1);
    }
    return message;
}

int main(int argc, char** argv) {
    if (argc != 4) return 2;
    igtl::ClientSocket::Pointer socket = igtl::ClientSocket::New();
    if (socket->ConnectToServer(argv[1], std::atoi(argv[2])) != 0) return 3;
    for (int left = std::atoi(argv[3]); left > 0; --left) {
        igtl::MessageHeader::Pointer header = igtl::MessageHeader::New();
        header->InitPack();
        bool timeout(false);
        if (socket->Receive(header->GetPackPointer(), header->GetPackSize(), timeout) == 0) return 4;
        header->Unpack();
        const std::string kind = header->GetDeviceType(), name = header->GetDeviceName();
        std::printf("%s %s", kind.c_str(), name.c_str());
        if (kind == "TRANSFORM") {
            igtl::Matrix4x4 matrix;
            receive<igtl::TransformMessage>(socket, header)->GetMatrix(matrix);
            std::printf(" %.6g %.6g %.6g", matrix[0][3], matrix[1][3], matrix[2][3]);
        } else if (kind == "STATUS") {
            igtl::StatusMessage::Pointer status = receive<igtl::StatusMessage>(socket, header);
            std::printf(" %d %s", status->GetCode(), status->GetErrorName());
        } else if (kind == "STRING") {
            std::printf(" %s", receive<igtl::StringMessage>(socket, header)->GetString());
        } else if (kind == "SENSOR") {
            igtl::SensorMessage::Pointer sensor = receive<igtl::SensorMessage>(socket, header);
            for (unsigned i = 0; i < sensor->GetLength(); ++i) std::printf(" %.6g", sensor->GetValue(i));
        } else if (kind == "POLYDATA") {
            igtl::PolyDataMessage::Pointer line = receive<igtl::PolyDataMessage>(socket, header);
            igtlFloat32 last[3];
            const int count = line->GetPoints()->GetNumberOfPoints();
            line->GetPoints()->GetPoint(count - 1, last);
            std::printf(" %d %d %.6g %.6g %.6g", count, line->GetLines()->GetNumberOfCells(), last[0], last[1], last[2]);
        } else {
            socket->Skip(header->GetBodySizeToRead(), 0);
        }
        std::printf("\n");
    }
    socket->CloseSocket();
    return 0;
}
